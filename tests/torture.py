"""How hard the tests of reliability try: a little in every run, much more by ``make torture``."""

import os


def tries(usual, torture):
    """Return ``torture`` under ``make torture``, else ``usual``."""
    return torture if os.environ.get("TORTURE") else usual
