"""Robustness of policies to starts that training never had."""
