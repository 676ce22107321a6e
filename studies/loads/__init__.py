"""The study of loads tied to links, and of machines on fixed bases."""
