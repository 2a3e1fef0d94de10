"""The picture shows what is in front, where it is, in its colour."""

from __future__ import annotations

import numpy as np
import pytest

from examples.render import Camera, Patches, boundary_faces, render, triangles

FROM_ABOVE = Camera(azimuth=-90.0, elevation=90.0)


def square(z: float, side: float, colour: tuple[float, float, float]) -> Patches:
    """A horizontal face of 9 nodes around the origin."""
    t = np.linspace(-side / 2, side / 2, 3)
    x, y = np.meshgrid(t, t, indexing="ij")
    points = np.stack([x, y, np.full_like(x, z)], axis=-1).reshape(1, 9, 3)
    return Patches(points, np.tile(np.array(colour), (1, 9, 1)))


def both(first: Patches, second: Patches) -> Patches:
    return Patches(
        np.concatenate([first.points, second.points]),
        np.concatenate([first.colours, second.colours]),
    )


def test_two_elements_show_ten_faces() -> None:
    lattice = np.arange(5 * 3 * 3).reshape(5, 3, 3)
    cells = np.stack([lattice[:3].ravel(), lattice[2:].ravel()])
    faces, owners = boundary_faces(cells)
    assert len(faces) == 10
    assert np.bincount(owners).tolist() == [5, 5]
    shared = set(lattice[2].ravel())
    assert not any(set(face) == shared for face in faces)
    for face, owner in zip(faces, owners, strict=True):
        assert set(face) <= set(cells[owner])


@pytest.mark.parametrize("order", [1, -1])
def test_the_nearer_face_hides_the_other(order: int) -> None:
    red, blue = (0.8, 0.1, 0.1), (0.1, 0.1, 0.8)
    pair = (square(0.0, 2.0, blue), square(1.0, 1.0, red))[::order]
    picture = render(both(*pair), FROM_ABOVE, width=120, line=0.0)
    middle, side = picture[60, 60], picture[60, 15]
    assert middle[0] > 4 * middle[2]
    assert side[2] > 4 * side[0]


def test_a_face_covers_its_area() -> None:
    picture = render(square(0.0, 1.0, (1, 1, 1)), FROM_ABOVE, width=200, margin=0.1)
    assert picture.shape[:2] == (200, 200)
    assert picture[..., 3].sum() == pytest.approx((0.8 * 200) ** 2, rel=0.01)


def test_a_curved_face_is_followed() -> None:
    """The middle of a 9-node arc lies on the parabola, not on the chord."""
    arc = square(0.0, 2.0, (1, 1, 1))
    arc.points[..., 2] = 1 - arc.points[..., 0] ** 2
    points, normals, *_ = triangles(arc, cuts=4)
    np.testing.assert_allclose(points[:, 2], 1 - points[:, 0] ** 2, atol=1e-12)
    slope = np.stack([2 * points[:, 0], np.zeros(25), np.ones(25)], axis=1)
    slope /= np.linalg.norm(slope, axis=1, keepdims=True)
    np.testing.assert_allclose(np.abs((normals * slope).sum(axis=1)), 1, atol=1e-12)


def test_edges_are_inked_with_one_width() -> None:
    """A face twice as large has an edge line as wide as a small one's."""
    plain = render(square(0.0, 1.0, (1, 1, 1)), FROM_ABOVE, width=200, line=0.0)
    inked = render(square(0.0, 1.0, (1, 1, 1)), FROM_ABOVE, width=200, line=1.0)
    dark = (inked[100, :, 0] < 0.9 * plain[100, :, 0]).sum()
    assert 1 <= dark <= 4
