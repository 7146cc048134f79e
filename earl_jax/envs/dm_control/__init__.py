"""The two tasks of the paper's figure 2, after dm_control's suite."""
