"""Runs on disk: their config, folder, checkpoints and logs, and the progress display."""
