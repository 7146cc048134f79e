"""What a user can choose: tasks and methods by name, options, seeds and schedules, presets, and shares of a machine."""
