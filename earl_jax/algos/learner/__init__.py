"""The learner of every method: soft actor-critic, its networks and its replay."""
