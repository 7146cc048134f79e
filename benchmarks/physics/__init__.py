"""Physics: rates of the engines, and fidelity to recordings and to the original models."""
