"""Clock, place and rotation of a tracked body against the IMU, without the legs."""
