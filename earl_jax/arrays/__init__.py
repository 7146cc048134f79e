"""Arrays of numbers from untrusted files."""
