"""A ROS 2 node that estimates a legged robot's motion: IMU, joints and contacts in, odometry out.

    python ros2_node.py --ros-args -p filter:=leg -p robot:=spot_class

It listens to `imu` (sensor_msgs/Imu), `joint_states` (sensor_msgs/JointState, joints by the names
of the robot's model) and `contacts` (std_msgs/UInt8MultiArray, 0 or 1 a foot, in the order that
`surefoot robots NAME` lists), and publishes `odometry` (nav_msgs/Odometry). Each IMU message is a
sample, with the last joints and contacts before it.
"""

import numpy as np

import surefoot
from surefoot.extend import quaternion_from_matrix


class Estimation:
    """Messages in, states out. It needs nothing of ROS but the messages' fields."""

    def __init__(self, estimator, robot):
        self.estimator, self.robot = estimator, robot
        self.joints, self.contact, self.began = {}, None, None

    def on_joints(self, message):
        names = list(message.name)
        if missing := [name for name in self.robot.joint_names if name not in names]:
            raise ValueError(f"joint_states lacks {', '.join(missing)}")
        order = [names.index(name) for name in self.robot.joint_names]
        fields = {"q": message.position, "dq": message.velocity, "tau": message.effort}
        self.joints = {key: np.array(x)[order] for key, x in fields.items() if len(x)}

    def on_contacts(self, message):
        self.contact = np.array(message.data, dtype=bool)

    def on_imu(self, message):
        """The state at this message (`surefoot.estimator.core.state.NavState`), None at first."""
        if "q" not in self.joints or self.contact is None:
            return None
        stamp, w, a = message.header.stamp, message.angular_velocity, message.linear_acceleration
        gyro, accel = np.array([w.x, w.y, w.z]), np.array([a.x, a.y, a.z])
        now = 10**9 * stamp.sec + stamp.nanosec
        # Relative to the first message: floats resolve seconds since the epoch to 0.2 us only.
        self.began = now if self.began is None else self.began
        t = 1e-9 * (now - self.began)
        sample = surefoot.Sample(t, gyro, accel, contact=self.contact, **self.joints)
        return self.estimator.step(sample)


def fill(odometry, state):
    """Pose in the world and velocity in the IMU's own axes, as nav_msgs/Odometry has them."""
    place, turn = odometry.pose.pose.position, odometry.pose.pose.orientation
    place.x, place.y, place.z = state.p_GI.tolist()
    turn.w, turn.x, turn.y, turn.z = quaternion_from_matrix(state.R_GI[None])[0].tolist()
    speed = odometry.twist.twist.linear
    speed.x, speed.y, speed.z = (state.R_GI.T @ state.v_GI).tolist()
    return odometry


def main():
    import rclpy
    from nav_msgs.msg import Odometry
    from rclpy.node import Node
    from sensor_msgs.msg import Imu, JointState
    from std_msgs.msg import UInt8MultiArray

    rclpy.init()
    node = Node("surefoot")
    for name, default in (("filter", "leg"), ("robot", "spot_class")):
        node.declare_parameter(name, default)
    robot = surefoot.Robot.load(node.get_parameter("robot").value)
    estimator = surefoot.StreamingEstimator(node.get_parameter("filter").value, robot)
    estimation = Estimation(estimator, robot)
    publisher = node.create_publisher(Odometry, "odometry", 10)

    def on_imu(message):
        state = estimation.on_imu(message)
        if state is not None:
            odometry = fill(Odometry(), state)
            odometry.header.stamp, odometry.header.frame_id = message.header.stamp, "odom"
            odometry.child_frame_id = message.header.frame_id
            publisher.publish(odometry)

    node.create_subscription(JointState, "joint_states", estimation.on_joints, 10)
    node.create_subscription(UInt8MultiArray, "contacts", estimation.on_contacts, 10)
    node.create_subscription(Imu, "imu", on_imu, 100)
    rclpy.spin(node)


if __name__ == "__main__":
    main()
