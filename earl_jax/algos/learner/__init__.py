"""The learner of all methods: soft actor-critic, its networks and its replay."""
