"""Inputs of the pages about the paper: published rows and recorded demonstrations."""
