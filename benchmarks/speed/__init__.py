"""Speed of training: rates, the suite with peers, profiles, the cost of methods."""
