"""A self-contained HTML page about run folders."""
