"""The reader of series, called as its own process calls it."""

import io
import json

import h5py
import numpy as np
import pytest

from restoration.errors import CaseError
from restoration.series_reader import MOST_DATA, read_frame
from tests import test_attacks as attacks


def read(file, frame="-1"):
    filled = io.BytesIO()
    read_frame(filled, frame, file)
    filled.seek(0)
    return np.load(filled, allow_pickle=False)


def test_a_frame_arrives_whole(tmp_path):
    file = attacks.series(tmp_path)
    with h5py.File(file) as h5:
        x, unit = h5[attacks.FRAME]["points"][()], h5[attacks.FRAME]["point/unit"][()]
    found = read(file)
    about = json.loads(found["about"].tobytes())
    assert about["attributes"]["unit_names"] == ["salt", "shale"]
    assert about["elapsed"] == 0
    np.testing.assert_array_equal(found["x"], x)
    np.testing.assert_array_equal(found[f"data_{about['names'].index('unit')}"], unit)


@pytest.mark.parametrize("frame", ["1", "-2", "9" * 30])
def test_frames_that_are_not_there(tmp_path, frame):
    with pytest.raises(CaseError, match=r"no frame .*; the file has 1"):
        read(attacks.series(tmp_path), frame)


def many(h5):
    for i in range(MOST_DATA + 1):
        h5[attacks.FRAME]["point"][f"v{i}"] = np.zeros(50)


def of_another_length(h5):
    h5[attacks.FRAME]["point/more"] = np.zeros(51)


def empty(h5):
    h5[attacks.FRAME]["point/none"] = h5py.Empty(float)


def endless(h5):
    h5[attacks.FRAME].attrs["elapsed"] = np.inf


def timeless(h5):
    del h5[attacks.FRAME].attrs["elapsed"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (attacks.external_link, "000000 is a link"),
        (attacks.soft_link, "points is a link"),
        (attacks.loop, "there is no points"),
        (attacks.virtual, "points is filtered or stored elsewhere"),
        (attacks.stored_elsewhere, "points is filtered or stored elsewhere"),
        (attacks.compressed, "points is filtered or stored elsewhere"),
        (attacks.without_end, "points is larger than the file"),
        (attacks.overflowing, "points is larger than the file"),
        (attacks.of_many_axes, "points is not what it should be"),
        (attacks.a_type, "points is not what it should be"),
        (attacks.deep_attributes, "maximum recursion depth"),
        (many, "a particle has 102 values; at most 100 are read"),
        (of_another_length, "the arrays do not fit each other"),
        (empty, "none is not what it should be"),
        (endless, "its time is not finite"),
        (timeless, "elapsed"),
    ],
)
def test_what_is_refused(tmp_path, change, message):
    file = attacks.series(tmp_path)
    with h5py.File(file, "a") as h5:
        change(h5)
    with pytest.raises(CaseError) as caught:
        read(file)
    assert message in str(caught.value)
