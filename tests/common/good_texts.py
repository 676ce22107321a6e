"""Good files of each kind, with every key that a case changes: each of them is read as it is."""

SCENARIO = """
name = "short"
robot = "spot_class"
stand = 1.0
laps = 1
[[segment]]
duration = 3.0
forward = 0.5
lateral = 0.0
turn = 0.1
[[segment]]
repeat = 2
[[segment.segment]]
distance = 1.0
forward = 0.4
[ground]
mu = 0.8
half_size = 50.0
[[ground.patch]]
center = [1.0, 0.0]
size = [0.5, 2.0]
mu = 0.3
[[ground.strip]]
start = [2.0, 0.0]
end = [4.0, 0.0]
width = 2.0
heights = [0.0, 0.1]
steps = 0
rough = 0.0
grain = 0.4
[ranges]
mu = [0.9, 1.1]
speed = [0.9, 1.1]
period = [1.0, 1.0]
clearance = [1.0, 1.0]
gain = [1.0, 1.0]
payload = [0.0, 1.0]
patch_shift = 0.0
[sensors]
gyro_noise = 6.1e-5
rate = 0.0
instability_time = 300.0
contact_missed = 0.0
[gait]
duty = 0.6
noise_time = 0.1
"""

EFFECTS = """
[[effect]]
name = "payload"
target = "all"
value = 2.0
unit = "kg"
"""

MAP = """
[source]
rate = 100.0
[columns]
gyro_x = "wx"
gyro_y = "wy"
gyro_z = { column = "wz", unit = "rad/s", sign = 1.0, offset = 0.0 }
accel_x = "ax"
accel_y = "ay"
accel_z = { column = "az", unit = "m/s^2" }
q_FL_hip = "q"
force_FL = "f"
force_FR = "f"
force_RL = "f"
force_RR = "f"
[robot]
name = "spot_class"
imu_position = [0.0, 0.0, 0.1]
imu_orientation = [1.0, 0.0, 0.0, 0.0]
foot_radius = 0.02
joint_sign = { FL_hip = 1.0 }
joint_offset = { FL_hip = 0.0 }
[contact]
on = 20.0
off = 10.0
debounce = 0.01
"""

CSV = "wx,wy,wz,ax,ay,az,q,f\n" + "0.01,0.02,0.0,0.1,0.2,9.8,0.3,50\n" * 400

EXPERIMENT = """
title = "hostile"
scenarios = ["scenario.toml"]
robots = ["spot_class"]
seeds = [0]
gammas = [0.8]
filters = ["leg"]
[observer]
steps = 25
model = "gru"
inputs = "q,dq"
[sweep]
gammas = [0.9]
[[condition]]
name = "plain"
words = "as it is"
effects = "effects.toml"
"""

SETTINGS = """
[noise]
gyro = 1e-3
accel = 1e-2
"""

ROBOT = """<mujoco model="mine">
  <compiler angle="radian"/>
  <size memory="1M"/>
  <asset><texture name="t" type="2d" builtin="flat" width="10" height="10"/></asset>
  <worldbody>
    <body name="arm" pos="0 0 1">
      <joint name="shoulder" type="hinge" axis="0 1 0" armature="0.01"/>
      <geom name="rod" type="capsule" size="0.02 0.2" mass="1.0" friction="1 0.005 0.0001"/>
    </body>
  </worldbody>
</mujoco>
"""

URDF = """<robot name="mine">
  <link name="base"><inertial><mass value="5"/>
    <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
  <link name="arm"><inertial><origin xyz="0 0 0.1"/><mass value="1"/>
    <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="arm"/>
    <axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="10" velocity="10"/></joint>
</robot>
"""
