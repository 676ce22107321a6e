"""What the robot walks on: terrain, its height map, and its geoms."""
