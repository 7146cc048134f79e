"""The tasks with the interfaces of `gymnasium`, of `brax`, and of the original benchmark (`earl_benchmark`)."""
