"""The world that makes data: robots, terrain, gait, sensors, effects and the Log."""
