"""Draw a body while it is cut: a picture (PNG) and a film (GIF), without a display and without a system library.

Prints:
    wrote cut.png (360, 240)
    wrote cut.gif, 12 frames
"""

import numpy as np
from PIL import Image

import gmapspring as gs
from gmapspring.render import render_body

SIZE = (360, 240)
mesh = gs.meshes.box((6, 2, 2), spacing=0.01)
middle = mesh.points[mesh.tetrahedra].mean(axis=1)
is_left = middle[:, 0] < 0.03
simulation = gs.Simulation(
    mesh,
    gs.Material(young_modulus=10e3, density=1000.0, viscosity=20.0),
    pinned=(mesh.points[:, 0] == 0.0) | np.isclose(mesh.points[:, 0], 0.06),
    gravity=(0, 0, -9.81),
    integrator="symplectic_euler",
)
image = simulation.body.gmap.image
across = [(t, int(n)) for t in np.flatnonzero(is_left) for n in image[t] // 24 if not is_left[n]]
across.sort(key=lambda pair: -middle[list(pair), 2].sum())  # from the top downwards

frames = []
for count in range(12):
    if count and across:
        simulation.cut(faces=across[:1])
        del across[:1]
    simulation.advance(0.05)
    strain = gs.measure.tetrahedron_strains(simulation.body)
    frames.append(Image.fromarray(render_body(simulation.body, strain=strain, size=SIZE)))
frames[-1].save("cut.png")
frames[0].save("cut.gif", save_all=True, append_images=frames[1:], duration=150, loop=0)
print("wrote cut.png", Image.open("cut.png").size)
print(f"wrote cut.gif, {Image.open('cut.gif').n_frames} frames")
