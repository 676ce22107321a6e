"""The paper's Monte-Carlo study, and a study of a single coverage update."""
