"""The tasks with the interfaces of `gymnasium`, `brax` and the original benchmark (`earl_benchmark`)."""
