"""Means of the viscosity, by name.

A mean of viscosities is ``f_inverse(mean of f(eta))``. The particles are averaged in ``f``; the
forms take ``f_inverse`` of the averaged field, so inside a cell the field is the same kind of mean.
"""

from ufl import exp

VISCOSITY_OF_MEAN = {
    "arithmetic": lambda mean: mean,
    "geometric": exp,
    "harmonic": lambda mean: 1 / mean,
}
