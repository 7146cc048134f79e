"""What is made of run folders: tables beside the published ones, and plots."""
