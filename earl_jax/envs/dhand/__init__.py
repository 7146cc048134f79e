"""DHand lightbulb."""
