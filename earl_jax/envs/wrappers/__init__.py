"""Environments that wrap a task."""
