"""Meshes of sections, with named walls."""
