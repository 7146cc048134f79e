"""The two tasks of the paper's figure 2, from the DeepMind Control Suite."""
