"""Minitaur pen."""
