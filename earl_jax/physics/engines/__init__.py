"""The physics engines: `c` on the host, `mjx` and `warp` on the accelerator."""
