"""Host functions inside jitted programs, through XLA's foreign function interface."""
