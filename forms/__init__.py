"""Weak forms of the physics, in UFL and nothing else."""
