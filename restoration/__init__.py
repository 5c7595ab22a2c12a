"""Restoration of geological sections by reverse-time Stokes flow."""

__version__ = "0.1.0"
