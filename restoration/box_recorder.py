"""The tasks of a run in three dimensions: sheets in the place of lines, cuts and maps."""

from dataclasses import replace

import numpy as np

from restoration.box_engine import BoxEngine
from restoration.box_figures import Shot, draw_box, draw_box_return
from restoration.canvas import time_text
from restoration.diagnostics import compared
from restoration.output import MeshSeries
from restoration.recorder import Recorder
from restoration.sheets import flatness, joined, sheet_distances


class BoxRecorder(Recorder):
    """Writes the run folder of a box in three dimensions.

    Args:
        job: `run_folder.Job`.
        folder: the run folder, made and empty.
        progress: `progress.Progress`, or None.
        memory: as of a `Recorder`.
    """

    def __init__(self, job, folder, progress=None, memory=None):
        super().__init__(job, folder, progress, memory, BoxEngine)
        self.horizons = None

    def compare(self):
        """Compare the marks, and draw them side by side and against where the run began."""
        figures, shots = self.folder / "figures", self._shots(self._marks)
        self.ranks.alone(draw_box, figures / "strip.png", shots)
        found = compared(self._marks, self._volumes, sheet_distances)
        self.record |= found
        if "there_and_back" in found:
            last = self._marks[-1].particles
            start = np.where(last.inside[:, None], last.start, np.nan)
            start = replace(shots[0], x=start, unit=last.unit)
            path = figures / "there-and-back.png"
            self.ranks.alone(draw_box_return, path, start, shots[-1], found["there_and_back"])

    def _open_series(self):
        super()._open_series()
        names = [sheet.name for sheet in self.scene.sheets]
        until = self._until if names else None
        self.horizons = MeshSeries(self.folder / "horizons.xdmf", {"names": names}, until)

    def _shots(self, states):
        befores = [None, *(state.time for state in states)]
        return [
            Shot(
                self.scene,
                state.time,
                state.particles.x,
                state.particles.unit,
                state.lines,
                time_text(self.scene, state.time, before),
            )
            for state, before in zip(states, befores, strict=False)
        ]

    def _flatness(self, state):
        return flatness(state.lines)

    def _note_topography(self, state):
        """Note nothing: dynamic topography is found along lines only."""

    def _lines_path(self, _):
        """Return none: sheets are in a series."""

    def _picture(self, name, state, before):
        """Draw a cut and a map at a mark."""
        shots = self._shots([state])
        label = time_text(self.scene, state.time, before)
        path = self.folder / "figures" / f"section-{name}.png"
        self.ranks.alone(draw_box, path, [replace(shots[0], label=label)])

    def _write_frame(self, state):
        super()._write_frame(state)
        if state.lines:
            points, cells, sheet = joined(state.lines)
            data = {"horizon": sheet}
            self.horizons.write(self.elapsed, points, cells, data, time=state.time)
