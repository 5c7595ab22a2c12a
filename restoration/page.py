"""A page laid out in pixels, and the words and numbers on it.

matplotlib is imported by the functions, because it takes two seconds; nothing here uses its global
state, and no picture carries a date or a version, so that the same run gives the same bytes.
"""

from contextlib import contextmanager
from pathlib import Path

import numpy as np

from restoration.writing import replacing

DPI = 160
INK = "#222222"
STYLE = {"font.size": 9, "text.parse_math": False, "axes.linewidth": 0.8, "axes.edgecolor": INK}


class Page:
    """A figure whose parts are placed in pixels from its lower left corner.

    Args:
        width: pixels.
        height: pixels.
    """

    def __init__(self, width, height):
        from matplotlib.figure import Figure

        self.size = np.array([width, height, width, height], dtype=float)
        self.figure = Figure(figsize=(width / DPI, height / DPI), dpi=DPI, facecolor="white")

    def axes(self, left, bottom, width, height):
        """Return new axes at this place."""
        return self.figure.add_axes(np.array([left, bottom, width, height]) / self.size)

    def text(self, left, bottom, text, **style):
        """Write a line of text that begins (unless ``ha`` says otherwise) at this place."""
        self.figure.text(left / self.size[0], bottom / self.size[1], text, color=INK, **style)

    def line(self, x, y):
        """Draw a black line through points in pixels."""
        from matplotlib.lines import Line2D

        line = Line2D(np.divide(x, self.size[0]), np.divide(y, self.size[1]), color=INK, lw=1.6)
        line.set_solid_capstyle("butt")
        self.figure.add_artist(line)

    def legend(self, handles, left, top, **settings):
        """Place a legend with its upper left corner here."""
        self.figure.legend(
            handles=handles,
            loc="upper left",
            bbox_to_anchor=(left / self.size[0], top / self.size[1]),
            borderaxespad=0,
            frameon=False,
            **settings,
        )

    def save(self, path):
        """Write the page as a PNG file, whole or not at all."""
        with replacing(Path(path)) as temporary:
            self.figure.savefig(temporary, format="png", metadata={"Software": None})


@contextmanager
def style():
    """Draw with this module's settings, whatever the user's own matplotlib settings are."""
    import matplotlib

    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(STYLE)
        yield


def legend_size(handles):
    """Return the width and the height to leave for a legend, pixels."""
    lines = [line for handle in handles for line in handle.get_label().split("\n")]
    return 110 + 12 * max(map(len, lines)), 29 * len(lines)


def shorten(text, longest):
    """Return text on one line of at most ``longest`` characters."""
    text = " ".join(text.split())
    if len(text) <= longest:
        return text
    return text[: longest - 1].rstrip() + "\N{HORIZONTAL ELLIPSIS}"


def round_number(value):
    """Return the largest of 1, 2, 5 times a power of ten that is not above ``value``."""
    power = 10.0 ** np.floor(np.log10(value))
    return max(factor * power for factor in (1, 2, 5) if factor * power <= value * (1 + 1e-12))
