"""The two Sawyer tasks: close a door, insert a peg."""
