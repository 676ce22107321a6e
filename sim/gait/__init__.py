"""The controller of a walk: the course, legs in swing and in stance."""
