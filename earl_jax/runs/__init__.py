"""Runs on disk: config, folder, checkpoints, logs and progress."""
