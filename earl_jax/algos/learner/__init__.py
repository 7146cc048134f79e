"""Learners, with their networks and their replay."""
