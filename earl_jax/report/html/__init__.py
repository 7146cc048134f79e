"""The html page of run folders, part by part."""
