"""How a life is judged: deployed and continuing evaluation, and statistics over seeds."""
