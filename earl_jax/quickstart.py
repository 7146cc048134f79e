"""`make quickstart`: an autonomous agent learns tabletop organization on a laptop's CPU, in minutes."""
