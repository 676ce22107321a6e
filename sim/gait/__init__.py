"""The gait controller: course, legs in swing and in stance."""
