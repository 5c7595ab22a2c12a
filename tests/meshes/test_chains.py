"""Chains of nodes, and where they follow a line best."""

import numpy as np
import pytest

from meshes.chains import along, arc_lengths, best_nodes, chains

CORNER_TURN = np.array([[0, 0], [1, 0], [1, 1.0]])


def bump(n):
    x = np.linspace(0, 1, n)
    return np.column_stack([x, 0.1 * np.cos(np.pi * x)])


def beside(nodes, line):
    """Area between a chain and a line."""
    x, y = np.vstack([nodes, line[::-1]]).T
    return 0.5 * abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1)))


def test_chains_go_from_junction_to_junction():
    edges = np.array([[1, 2], [2, 3], [3, 4], [3, 5], [7, 8], [8, 9], [9, 7]])
    found = sorted(chain.tolist() for chain in chains(edges, [2]))
    assert found == [[1, 2], [2, 3], [3, 4], [3, 5], [7, 8, 9, 7]]


def test_a_ring_keeps_its_area():
    angle = np.linspace(0, 2 * np.pi, 2001)
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    s = np.linspace(0, arc_lengths(ring)[-1], 25)
    on, best = along(ring, s), best_nodes(along(ring, s), ring, s)
    area = lambda x: 0.5 * np.sum(x[:-1, 0] * x[1:, 1] - x[1:, 0] * x[:-1, 1])  # noqa: E731
    assert area(on) < 0.99 * area(ring)
    assert area(best) == pytest.approx(area(ring), rel=1e-8)
    assert np.hypot(*best.T).min() == pytest.approx(1)


@pytest.mark.parametrize("across", [None, (0.0, 1.0)])
def test_ends_slide_along_walls_and_the_area_stays(across):
    line = bump(801)
    for n in (7, 14):
        s = np.linspace(0, arc_lengths(line)[-1], n)
        best = best_nodes(along(line, s), line, s, ((0.0, 1.0), (0.0, 1.0)), across)
        assert best[[0, -1], 0] == pytest.approx([0, 1])
        x, z = best.T
        assert np.trapz(z, x) == pytest.approx(np.trapz(line[:, 1], line[:, 0]), abs=1e-12)
        assert best[0, 1] > 0.1  # above the crest, as a least-squares line is
        held = best_nodes(along(line, s), line, s, (None, None), across)
        assert held[[0, -1]] == pytest.approx(line[[0, -1]])


def test_the_distance_falls_with_the_square_of_the_edges():
    line, far = bump(3201), []
    for n in (9, 17, 33):
        s = np.linspace(0, arc_lengths(line)[-1], n)
        best = best_nodes(along(line, s), line, s, ((0.0, 1.0), (0.0, 1.0)))
        z = np.interp(line[:, 0], *best.T)
        far.append(np.sqrt(np.mean((z - line[:, 1]) ** 2)))
        assert far[-1] < 0.5 * np.sqrt(
            np.mean((np.interp(line[:, 0], *along(line, s).T) - line[:, 1]) ** 2)
        )
    assert np.log2(far[0] / far[1]) > 1.9
    assert np.log2(far[1] / far[2]) > 1.9


def test_straight_lines_and_pairs_stand():
    line = np.column_stack([np.linspace(0, 1, 40), np.linspace(0, 2, 40)])
    s = np.linspace(0, arc_lengths(line)[-1], 6)
    assert best_nodes(along(line, s), line, s) == pytest.approx(along(line, s))
    two = best_nodes(along(line, s[[0, -1]]), line, s[[0, -1]])
    assert two == pytest.approx(line[[0, -1]])
    three = best_nodes(along(line, s[[0, 2, -1]]), line, s[[0, 2, -1]])
    assert three == pytest.approx(along(line, s[[0, 2, -1]]))
