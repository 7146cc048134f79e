"""The physics engines: `c` on the host's threads, `mjx` and `warp` on the accelerator."""
