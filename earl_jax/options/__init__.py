"""What a user can choose: tasks and methods by name, options and their intervals, presets, and shares of a machine."""
