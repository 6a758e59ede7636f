"""Build a mesh of your own from points and tetrahedra, give its parts different materials, and let it come to rest.

With a tolerance in place of a scheme, the package chooses scheme, precision and step.

Prints:
    a prism of 6 tetrahedra in 8 points, soft and stiff
    chosen: rk4
    at rest: True
"""

import numpy as np

import gmapspring as gs

HEIGHT, WIDTH = 0.02, 0.01
corners = np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) * WIDTH
points = np.concatenate([np.c_[corners, np.zeros(4)], np.c_[corners, np.full(4, HEIGHT)]])
# The six tetrahedra round the diagonal from point 0 to point 6.
ring = [1, 2, 3, 7, 4, 5]
tetrahedra = np.array([(0, ring[i], ring[(i + 1) % 6], 6) for i in range(6)])
mesh = gs.Mesh(points, tetrahedra)

young_modulus = np.where(np.arange(6) < 3, 2e3, 20e3)
simulation = gs.Simulation(
    mesh,
    gs.Material(young_modulus=young_modulus, density=1000.0, viscosity=30.0),
    pinned=points[:, 2] == 0.0,
    gravity=(0, 0, -9.81),
    tolerance=1e-2,
)
print(f"a prism of {mesh.n_tetrahedra} tetrahedra in {mesh.n_points} points, soft and stiff")
print("chosen:", simulation.integrator.name)
simulation.advance(3.0, rest_tolerance=1e-6)
speed = np.linalg.norm(simulation.body.nodes.velocity, axis=1).max()
print("at rest:", bool(speed < 1e-4))
