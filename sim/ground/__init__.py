"""Ground: terrain, its height map, and its geoms in MuJoCo."""
