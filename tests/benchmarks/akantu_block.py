"""Akantu's side of the comparison; runs in Akantu's environment, which has no phantomnode.

    akantu_block.py SIDE FOLDER

A square block of SIDE x SIDE quadrilaterals in explicit central differences with lumped mass and finite
deformation. FOLDER holds material.dat and velocity.npy, (n, 2), m/s, of the nodes row by row. Every number of
steps that comes in on a line is taken; the CPU and wall seconds go out.
"""

import sys
import time

import akantu
import numpy as np


def block(side):
    """The model of the block, and the mesh that must outlive it."""
    mesh, line = akantu.Mesh(2), np.linspace(0.0, 1.0, side + 1)
    quads, access = akantu._quadrangle_4, akantu.MeshAccessor(mesh)
    access.resizeNodes((side + 1) ** 2)
    mesh.getNodes()[:] = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    access.resizeConnectivity(side**2, quads)
    corner = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).reshape(-1, 1)
    mesh.getConnectivity(quads)[:] = corner + [0, 1, side + 2, side + 1]
    access.makeReady()
    model = akantu.SolidMechanicsModel(mesh)
    model.initFull(_analysis_method=akantu._explicit_lumped_mass)
    return model, mesh


def expect_finite_strain(model, mesh):
    """A rotation by a right angle must leave no force: small strains would see a strain of one in it."""
    xy, u, modulus = mesh.getNodes(), model.getDisplacement(), 1e10
    u[:] = np.stack([-xy[:, 1], xy[:, 0]], axis=-1) - xy
    model.assembleInternalForces()
    force = np.abs(model.getInternalForce()).max()
    u[:] = 0.0
    if force > 1e-6 * modulus / np.sqrt(len(xy)):
        raise SystemExit(f"Akantu is not in finite deformation: a rotation makes forces of {force:g} N/m")


def main(side, folder):
    """Build, warm up, then take orders."""
    akantu.parseInput(f"{folder}/material.dat")
    model, mesh = block(side)
    expect_finite_strain(model, mesh)
    model.setTimeStep(0.8 * model.getStableTimeStep())
    model.getVelocity()[:] = np.load(f"{folder}/velocity.npy")
    model.solveStep()
    print("ready", flush=True)
    for line in sys.stdin:
        cpu, wall = time.process_time(), time.perf_counter()
        for _ in range(int(line)):
            model.solveStep()
        print(time.process_time() - cpu, time.perf_counter() - wall, flush=True)
        if not np.isfinite(model.getDisplacement()).all():
            raise SystemExit("Akantu's run is no longer finite")


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2])
