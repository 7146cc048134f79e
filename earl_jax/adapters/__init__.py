"""The tasks in the conventions of other libraries: `gymnasium`, `brax` and the original benchmark's `EARLEnvs` (`earl`)."""
