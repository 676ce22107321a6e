"""Robots as their MJCF says: legs, kinematics, home pose, the names they are known by."""

from surefoot.sim.robot.robot import DeclaredExtras, Robot

__all__ = ["DeclaredExtras", "Robot"]
