"""Logs, observers and bounds that are broken: one line a case, `what` it is, what it does to the
good one (columns `c`, metadata `m`; the plain values `v` of an observer or of bounds), and a word
that the error must have."""

# fmt: off

import numpy as np

NAN = float("nan")


def put(c, name, rows, value):
    """Readings of a column replaced at some rows."""
    c[name] = c[name].copy()
    c[name][rows] = value


def rename(c, old, new):
    """A column under another name."""
    c[new] = c.pop(old)


LOG = [
    ("time that runs backwards", lambda c, m: c.update(t=c["t"][::-1].copy()), "jumps back"),
    ("time in milliseconds", lambda c, m: c.update(t=1e3 * c["t"]), "Hz"),
    ("a rate of nothing", lambda c, m: m.update(rate=0.0), "rate"),
    ("a rate of another kind", lambda c, m: m.update(rate="fast"), "rate"),
    ("a rate of a day", lambda c, m: m.update(rate=1.0 / 86400), "rate"),
    ("a rate of hours, pieces of a row", lambda c, m: m.update(rate=0.02), "Hz"),
    ("an unknown key", lambda c, m: m.update(evil=1), "evil"),
    ("a schema of tomorrow", lambda c, m: m.update(schema=99), "newer"),
    ("a schema of nothing", lambda c, m: m.update(schema=0), "schema"),
    ("a robot that is a list", lambda c, m: m.update(robot=["a"]), "robot"),
    ("a robot of the system", lambda c, m: m.update(robot="/etc/passwd"), "robot"),
    ("a robot of 300 letters", lambda c, m: m.update(robot="r" * 300), "robot"),
    ("effects that are a number", lambda c, m: m.update(effects=3), "effects"),
    ("effects without a name", lambda c, m: m.update(effects=[{"value": 1.0}]), "name"),
    ("effects of no catalogue", lambda c, m: m.update( effects=[{"name": "ghost", "target": "all", "value": 1.0, "unit": "m"}] ), "ghost"),
    ("effects beyond their bounds", lambda c, m: m.update( effects=[{"name": "payload", "target": "all", "value": 1e9, "unit": "kg"}] ), "payload"),
    ("a mounting of two numbers", lambda c, m: m.update(model={"p_BI": [1, 2]}), "p_BI"),
    ("a mounting of length two", lambda c, m: m.update(model={"q_BI": [2, 0, 0, 0]}), "q_BI"),
    ("feet of a number", lambda c, m: m.update(model={"feet": 4}), "feet"),
    ("a foot's radius of text", lambda c, m: m.update(model={"foot_radius": "big"}), "foot_radius"),
    ("metadata in metadata", lambda c, m: m.update(model={"x": eval("[" * 90 + "]" * 90)}), ""),
    ("readings of no number", lambda c, m: put(c, "gyro_x", slice(10, 90), NAN), "80 rows"),
    ("a reading of 1e300", lambda c, m: put(c, "gyro_y", 200, 1e300), "gyro_y"),
    ("a reading of 1e13", lambda c, m: put(c, "ref_p_x", 200, 1e13), "ref_p_x"),
    ("a column of truth values", lambda c, m: c.update(gyro_x=c["gyro_x"] > 0), "gyro_x"),
    ("a column of no name", lambda c, m: rename(c, "gyro_x", ""), "column"),
    ("a column of many lines", lambda c, m: rename(c, "gyro_x", "gyro\n_x"), "column"),
    ("a joint without position", lambda c, m: c.pop("q_FR_thigh"), "q_FR_thigh"),
    ("half a quaternion", lambda c, m: c.pop("ref_q_z"), "ref_q_z"),
    ("a quaternion of nothing", lambda c, m: [put(c, f"ref_q_{a}", 50, 0.0) for a in "wxyz"], "unit"),
    ("three rows", lambda c, m: [c.update({n: v[:3]}) for n, v in list(c.items())], "in common"),
    ("two rows", lambda c, m: [c.update({n: v[:2]}) for n, v in list(c.items())], "rows"),
    ("a reference's flag of two", lambda c, m: c.update(ref_ok=np.full(len(c["t"]), 2.0)), "ref_ok"),
    ("a contact of three legs", lambda c, m: c.update({f"contact_{g}": np.ones(len(c["t"])) for g in ("FL", "FR", "XX")}), "leg"),
    ("half a foot", lambda c, m: c.update(foot_FL_x=c["t"]), "column foot_"),
    ("half a force", lambda c, m: c.update(force_FL_x=c["t"]), "column force_"),
    ("a foot of no leg", lambda c, m: c.update({f"foot_XX_{a}": c["t"] for a in "xyz"}), "column contact_XX is missing beside foot_XX_x"),
    ("a foot of no axis", lambda c, m: c.update(foot_FL=c["t"]), "unknown column foot_FL"),
    ("rows in another order", lambda c, m: c.update({n: np.roll(v, 100) for n, v in list(c.items())}), "jumps back"),
    ("time since 1970 in nanoseconds", lambda c, m: c.update(t=1e9 * c["t"] + 1.7e18), ""),
    ("a motor law of no number", lambda c, m: m.update(motor_law={"kp": [NAN] * 12, "kd": [1.0] * 12}), "motor_law"),
    ("a robot of two lines", lambda c, m: m.update(robot="spot\nclass"), "robot"),
    ("a leg of nobody", lambda c, m: [rename(c, f"{k}_FL_hip", f"{k}_XX_hip") for k in ("q", "dq", "tau")], ""),
]

BOUNDS = [
    ("narrower bounds by hand", lambda v: v.update(epsilon=[1e-3, 1e-3, 1e-3])),
    ("another observer by hand", lambda v: v.update(observer="0" * 64)),
    ("no digest", lambda v: v.pop("digest")),
    ("a digest of a list", lambda v: v.update(digest=[1])),
]

OLD_BOUNDS = [
    ("a mirror for a rotation", lambda v: v.update(R_BI=[[1, 0, 0], [0, 1, 0], [0, 0, -1]]), "R_BI"),
    ("a rotation of two rows", lambda v: v.update(R_BI=[[1, 0, 0], [0, 1, 0]]), "R_BI"),
    ("bounds of nothing", lambda v: v.update(epsilon=[0, 0, 0]), "epsilon"),
    ("bounds of 1e400", lambda v: v.update(epsilon=[10**400, 1, 1]), "bounds"),
    ("no bounds", lambda v: v.pop("epsilon"), "epsilon"),
    ("a level of one", lambda v: v.update(gamma=1.0), "gamma"),
    ("a level of nothing", lambda v: v.update(gamma=0.0), "gamma"),
    ("half a sample", lambda v: v.update(n=0.5), "K and n"),
    ("a spacing below zero", lambda v: v.update(K=-1), "K and n"),
    ("an observer that is a number", lambda v: v.update(observer=3), "observer"),
    ("a curve that is empty", lambda v: v.update(mixing={}), "bounds"),
    ("a persistent part of nothing", lambda v: v.update(persistent={}), "bounds"),
    ("a confidence of two", lambda v: v.update(confidence=2.0), "confidence"),
    ("an unknown key", lambda v: v.update(evil=1), "bounds"),
    ("a schema of tomorrow", lambda v: v.update(schema=99), "schema"),
    ("another format", lambda v: v.update(format="surefoot observer"), "not surefoot bounds"),
]

OBSERVER = [
    ("another format", lambda v: v.update(format="x"), "not a surefoot observer"),
    ("a schema of tomorrow", lambda v: v.update(schema=99), "schema"),
    ("a width of a billion", lambda v: v.update(width=10**9), "width"),
    ("a width of nothing", lambda v: v.update(width=0), "width"),
    ("an unknown network", lambda v: v.update(model="oracle"), "oracle"),
    ("an unknown loss", lambda v: v.update(loss="luck"), "luck"),
    ("inputs of nothing", lambda v: v.update(inputs=[]), "inputs"),
    ("no weights", lambda v: v.update(weights={}), "observer"),
    ("weights of no number", lambda v: v["weights"].update({k: w * NAN for k, w in v["weights"].items()}), "finite"),
    ("weights of float64", lambda v: v["weights"].update({k: w.astype(float) for k, w in v["weights"].items()}), "float32"),
    ("weights of one number", lambda v: v["weights"].update({k: w.flatten()[:1] for k, w in v["weights"].items()}), "observer"),
    ("weights that are a list", lambda v: v.update(weights=[1]), "observer"),
    ("other weights", lambda v: v["weights"].update({k: w + 1 for k, w in v["weights"].items()}), "damaged"),
    ("a mirror for a rotation", lambda v: v.update(R_BI=np.diag([1.0, 1.0, -1.0])), "R_BI"),
    ("a mounting nowhere", lambda v: v.update(p_BI=np.full(3, NAN)), "p_BI"),
    ("scales of nothing", lambda v: v.update(input_scale=0 * v["input_scale"]), "scale"),
    ("scales of no number", lambda v: v.update(output_scale=v["output_scale"] * NAN), "output_scale"),
    ("a joint too many", lambda v: v.update(joints=[*v["joints"], "tail"]), "shape"),
    ("no joints", lambda v: v.update(joints=[]), "shape"),
    ("logs that are a number", lambda v: v.update(logs=3), "observer"),
    ("a robot that is a number", lambda v: v.update(robot=3), "robot"),
    ("a rate of text", lambda v: v.update(rate="fast"), "rate"),
    ("legs without feet", lambda v: v.update(legs={"radius": [0.02]}), "legs"),
    ("no errors", lambda v: v.pop("errors"), "errors"),
]
