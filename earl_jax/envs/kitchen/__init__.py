"""Franka kitchen."""
