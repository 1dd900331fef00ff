"""The plane or space that a scene lies in."""

from __future__ import annotations

from typing import Any

import numpy as np

from . import scene as sc


def basis_of(scene: sc.Scene) -> np.ndarray:
    """Rows: the axes of the scene's vertical plane, or of space when the scene does not lie in one."""
    vectors: list[Any] = []
    for end in (scene.end_a, scene.end_b):
        for v in (end.direction, end.force):
            if v is not None:
                vectors.append(np.array(v))
        if end.motion:
            vectors += [np.array(h.amplitude) for h in end.motion.harmonics]
            if end.motion.stochastic:
                vectors.append(np.array(end.motion.stochastic.amplitude))
            if end.motion.table:
                vectors += list(np.array(end.motion.table.x))
    if scene.end_a.position is not None and scene.end_b.position is not None:
        vectors.append(np.array(scene.end_b.position) - np.array(scene.end_a.position))
    if scene.water and scene.water.current:
        vectors += [np.array(v) for v in scene.water.current.velocity]
    if scene.start.shape:
        shape = np.array(scene.start.shape)
        vectors += list(shape - shape[0])
        vectors += [np.array(v) for v in scene.start.velocity or ()]
    for device in scene.devices:
        if getattr(device, "direction", None) is not None:
            vectors.append(np.array(device.direction))  # type: ignore[union-attr]
    flat = np.array([v[:2] for v in vectors] or [np.zeros(2)])
    size = np.abs(flat).max()
    up = [0.0, 0.0, 1.0]
    if size == 0.0:
        return np.array([[1.0, 0.0, 0.0], up])
    along = flat[np.argmax(np.hypot(*flat.T))]
    along = along / np.hypot(*along)
    if along[np.argmax(np.abs(along))] < 0:
        along = -along
    if np.abs(flat @ np.array([-along[1], along[0]])).max() > 1e-12 * size:
        return np.eye(3)
    return np.array([[float(along[0]), float(along[1]), 0.0], up])
