"""The tables and figures of the paper, reproduced from our own runs."""
