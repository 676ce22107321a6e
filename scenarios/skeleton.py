"""`surefoot new`: write a working package for a plug-in, with its test."""

import keyword
import re
from pathlib import Path

from surefoot.scenarios.estimate.estimators import ESTIMATORS
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import bundled, whole_folder

TEMPLATES = bundled("surefoot.scenarios", "skeletons")


def new_estimator(name: str, out: Path, force: bool = False) -> list[str]:
    """Write a package with an estimator of this name; returns the paths of its files.

    Raises SurefootError for a name that cannot be a module's, or that an estimator already has.
    """
    if not re.fullmatch(r"[a-z][a-z0-9_]{0,60}", name) or keyword.iskeyword(name):
        raise SurefootError(
            f"{name!r} cannot be a module's name: lower-case letters, digits and underscores, a "
            "letter first"
        )
    if name in ESTIMATORS:
        raise SurefootError(f"there is an estimator {name} already")
    words = {
        "NAME": name,
        "CLASS": "".join(part.capitalize() for part in name.split("_")),
        "LABEL": name.replace("_", " ").capitalize(),
        "PROJECT": name.replace("_", "-"),
    }
    with whole_folder(out, force) as folder:
        for template in sorted((TEMPLATES / "estimator").glob("*.txt")):
            text = template.read_text(encoding="utf-8")
            for word, value in words.items():
                text = text.replace(f"@{word}@", value)
            (folder / template.stem.replace("NAME", name)).write_text(text, encoding="utf-8")
    return sorted(str(out / path.name) for path in out.iterdir() if not path.name.startswith("."))
