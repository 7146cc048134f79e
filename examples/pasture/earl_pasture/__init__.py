"""Two tasks, two methods and a learner for earl_jax, each in a file of its own."""
