"""How a leg's foot moves in the world, compiled; nothing is allocated, as it runs so often."""

from surefoot.sim.common.kernels import kernel


@kernel(nogil=True)
def foot_motion(p, R, v, w, rates, foot, J, axes, place, velocity, jacobian, spin):
    """From B to G, for one leg; writes the last four.

    p, R, v: base position, attitude, velocity in G; w (3,): angular velocity in B; rates (3,) of
    the leg's joints [rad/s]; foot (3,), J (3, 3), axes (3, 3): of `leg_forward`. place (3,) [m] and
    velocity (3,) of the foot's centre, its jacobian (3, 3), spin (3,) of its link, all in G.
    """
    wx, wy, wz = w[0], w[1], w[2]
    x, y, z = foot[0], foot[1], foot[2]
    a, b, c = rates[0], rates[1], rates[2]
    vx = wy * z - wz * y + J[0, 0] * a + J[0, 1] * b + J[0, 2] * c
    vy = wz * x - wx * z + J[1, 0] * a + J[1, 1] * b + J[1, 2] * c
    vz = wx * y - wy * x + J[2, 0] * a + J[2, 1] * b + J[2, 2] * c
    wx += axes[0, 0] * a + axes[0, 1] * b + axes[0, 2] * c
    wy += axes[1, 0] * a + axes[1, 1] * b + axes[1, 2] * c
    wz += axes[2, 0] * a + axes[2, 1] * b + axes[2, 2] * c
    for i in range(3):
        r, s, t = R[i, 0], R[i, 1], R[i, 2]
        place[i] = p[i] + r * x + s * y + t * z
        velocity[i] = v[i] + r * vx + s * vy + t * vz
        spin[i] = r * wx + s * wy + t * wz
        for j in range(3):
            jacobian[i, j] = r * J[0, j] + s * J[1, j] + t * J[2, j]


@kernel(nogil=True)
def sole_motion(velocity, spin, radius, normal, sole_v):
    """Writes the velocity (3,) of the contact point, `radius` below the centre along `normal`."""
    x, y, z = radius * normal[0], radius * normal[1], radius * normal[2]
    sole_v[0] = velocity[0] - (spin[1] * z - spin[2] * y)
    sole_v[1] = velocity[1] - (spin[2] * x - spin[0] * z)
    sole_v[2] = velocity[2] - (spin[0] * y - spin[1] * x)
