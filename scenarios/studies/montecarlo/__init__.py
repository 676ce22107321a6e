"""The paper's Monte-Carlo study, and the coverage update by itself."""
