"""Deployed and continuing evaluation, and statistics over seeds."""
