"""What a model file leaves to the reader: names of its parts, and which of its bodies is the
machine.
"""

import mujoco

from surefoot.sim.common.errors import SurefootError

_FREE, _HINGE = mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_HINGE


def name_parts(spec: mujoco.MjSpec) -> tuple[str, ...]:
    """Name the bodies and joints of a spec that have no name, which MJCF allows, by their number.

    Returns the change in words, if there is one.
    """
    changes = []
    joints = [joint for joint in spec.joints if joint.type != _FREE]
    for kind, parts in (("body", spec.bodies[1:]), ("joint", joints)):
        taken, named = {part.name for part in parts}, list[str]()
        for number, part in enumerate(parts, 1):
            if part.name:
                continue
            part.name = f"{kind}_{number}"
            while part.name in taken:
                part.name += "_"
            named.append(part.name)
        if named:
            first_and_last = " to ".join(dict.fromkeys((named[0], named[-1])))
            changes.append(f"numbered, as the file gives them no names: {first_and_last}")
    return tuple(changes)


def leave_out_surroundings(spec: mujoco.MjSpec) -> tuple[str, ...]:
    """Remove the other bodies of a scene in which something moves freely: balls, tables, carts.

    The machine is the body of the world with the most chains of two or more hinges. If it moves
    freely, all others go; if it is fixed to the world, those that
    move freely do. Its posture in the keyframe "home" remains. Returns the change in words, if
    there is one. Raises SurefootError where two bodies have equal claims.
    """
    bodies = list(spec.worldbody.bodies)
    free = [body for body in bodies if _is_free(body)]
    if len(bodies) < 2 or not free:
        return ()
    bodies.sort(key=_legs_below, reverse=True)
    machine, second = bodies[:2]
    if _legs_below(machine) == _legs_below(second) and _is_free(machine):
        raise SurefootError(
            f"its bodies {machine.name} and {second.name} may both be the robot: leave one out"
        )
    out = [b for b in (bodies if _is_free(machine) else free) if b.name != machine.name]
    left_out = [body.name for body in out]
    model = spec.copy().compile()
    inside = _joint_places(model, left_out)
    home = [model.key_qpos[i][inside] for i, key in enumerate(spec.keys) if key.name == "home"]
    for part in (*spec.keys, *out):
        spec.delete(part)
    for looking in (*spec.cameras, *spec.lights):
        if looking.targetbody and spec.body(looking.targetbody) is None:
            spec.delete(looking)
    for qpos in home:
        spec.add_key(name="home", qpos=qpos)
    return (f"left out, as no part of the robot: {', '.join(left_out)}",)


def _joint_places(model: mujoco.MjModel, out: list[str]) -> list[int]:
    """Elements of a model's qpos, without those of the bodies of the world with these names."""
    roots = model.body_rootid[model.jnt_bodyid]
    starts = [*model.jnt_qposadr.tolist(), model.nq]
    kept = (j for j in range(model.njnt) if model.body(roots[j]).name not in out)
    return [place for j in kept for place in range(starts[j], starts[j + 1])]


def _is_free(body: mujoco.MjsBody) -> bool:
    return any(joint.type == _FREE for joint in body.joints)


def _legs_below(body: mujoco.MjsBody, above: int = 0) -> int:
    """Number of chains of two or more hinges that end at or below a body, with those `above`."""
    hinges = above + sum(joint.type == _HINGE for joint in body.joints)
    return sum(_legs_below(child, hinges) for child in body.bodies) or int(hinges >= 2)
