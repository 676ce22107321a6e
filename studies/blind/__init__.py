"""The blind study of `trace`."""
