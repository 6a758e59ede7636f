"""The pictures of the documentation: drawn from the map as it is, and the same every time."""

import numpy as np
import pytest

from agents import pictures
from agents.link_picture import examples, link_counts, link_figure, link_surface
from agents.map_pictures import cut_figure, dart_places, darts_figure, ring, vertex_places
from gmapspring import Material, Simulation, meshes
from gmapspring.topology.gmap import link_characteristic

LINES = {"#d1495b": 12, "#2e8b57": 12, "#2f6db5": 12}
"""Links of each involution among 24 darts: it pairs all of them."""


def test_every_dart_of_a_tetrahedron_and_every_link_is_drawn():
    panel = darts_figure().axes[0]
    drawn = [line.get_color() for line in panel.lines if len(line.get_xdata())]
    assert {color: drawn.count(color) for color in LINES} == LINES
    assert len(panel.texts) == 24  # an arrow each
    # Two sewn tetrahedra share one face: six pairs of darts.
    other = [line.get_color() for line in darts_figure().axes[1].lines]
    assert other.count("#8e44ad") == 6


def test_darts_begin_at_their_vertex_and_run_along_their_edge():
    body = Simulation(meshes.single(), Material(1e3, 1e3)).body
    places = dart_places(body)
    assert places.shape == (24, 2, 3)
    assert len({tuple(np.round(place.ravel(), 9)) for place in places}) == 24


def test_the_picture_of_a_cut_counts_what_splits():
    titles = [panel.get_title() for panel in cut_figure().axes[:3]]
    # Euler characteristic of a ball, vertices - edges + faces - tetrahedra = 1, of two balls 2.
    for title, expected in zip(titles, (1, 1, 2), strict=True):
        vertices, edges, faces = (int(part.split()[0]) for part in title.splitlines()[1].split(", "))
        assert vertices - edges + faces - 6 == expected


def test_the_ring_round_an_edge_closes():
    body = Simulation(meshes.box((1, 1, 1)), Material(1e3, 1e3)).body
    pairs = ring(body)
    assert len(pairs) == 6
    assert all(one[1] == other[0] for one, other in zip(pairs, pairs[1:] + pairs[:1], strict=True))
    with pytest.raises(ValueError, match="no inner edge"):
        ring(Simulation(meshes.single(), Material(1e3, 1e3)).body)


def test_vertices_are_drawn_near_where_they_are():
    body = Simulation(meshes.box((1, 1, 1)), Material(1e3, 1e3)).body
    assert np.linalg.norm(vertex_places(body) - body.nodes.position, axis=1).max() < 0.15 * np.sqrt(3)


def test_links_are_a_sphere_a_disc_and_a_ring():
    shown = examples()
    assert [link_characteristic(example.body.gmap)[example.node] for example in shown] == [2, 1, 0]
    for example in shown:
        corners, edges, triangles = link_counts(example.body, example.node)
        assert corners - edges + triangles == link_characteristic(example.body.gmap)[example.node]
        assert len(link_surface(example.body, example.node).triangles) == 2 * triangles
    for panel, count in zip(link_figure().axes, (2, 1, 0), strict=True):
        assert panel.get_title().endswith(f"= {count}")


def test_pictures_are_the_same_bytes_every_time_and_small(tmp_path):
    contents = []
    for _ in range(2):
        files = pictures.write_pictures(tmp_path, only=["map"])
        contents.append([file.read_bytes() for file in files])
    assert contents[0] == contents[1]
    assert max(map(len, contents[0])) < pictures.LARGEST


def test_a_missing_folder_and_an_unknown_policy_are_told_in_a_line(tmp_path, capsys):
    assert pictures.main(["--out", str(tmp_path / "nowhere")]) == 1
    assert "there is no folder" in capsys.readouterr().err
    assert pictures.main(["rim-frist", "--only", "film", "--out", str(tmp_path)]) == 1
    assert "did you mean 'rim-first'" in capsys.readouterr().err
