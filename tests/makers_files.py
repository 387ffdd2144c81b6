"""Tries every robot description and every dictionary in a folder: `python -m tests.makers_files FOLDER`.

Prints one line a file that is not read, and the counts of docs/reference/makers-files.md.
"""

import re
import sys
from collections import Counter
from pathlib import Path

from drivers.commission.draft import map_text, profile_text, shortcomings
from drivers.commission.drive import read_dictionary
from drivers.errors import BadProfile
from service import BadInput
from service.formats.maker_urdf import check_urdf, read_description, side_file_text
from service.formats.maker_urdf.packages import Packages


def robot(path: Path, folder: Path) -> str:
    """How a robot description ends; of several chains the longest is taken. BadInput: it is refused."""
    packages = Packages([parent for parent in path.parents if parent.is_relative_to(folder)], path.parent)
    text = read_description(path, packages, {})
    try:
        checked = check_urdf(text, packages, None, str(path))
    except BadInput as error:
        tips = re.findall(r"(\S+) \((\d+) axes\)", error.reason)
        if not tips:
            raise
        checked = check_urdf(text, packages, max(tips, key=lambda tip: int(tip[1]))[0], str(path))
    side_file_text(checked, "robot", "robot.urdf")
    if checked.lacking:
        return "meshes or position limits are missing"
    return "told" if any(one.kind == "unusual" for one in checked.findings) else "read"


def dictionary(path: Path, _: Path) -> str:
    """How a dictionary ends. BadProfile: it is refused."""
    found = read_dictionary(path, 1)
    profile_text(found, ["joint_1"], path.name, "device.yaml", None)
    map_text(found)
    return "told" if shortcomings(found) else "read"


def main(folder: Path) -> None:
    counts = Counter[str]()
    for path in sorted(folder.rglob("*")):
        suffix = path.suffix.lower()
        tried = robot if suffix in (".urdf", ".xacro") else dictionary if suffix in (".eds", ".dcf") else None
        if tried is None or not path.is_file():
            continue
        try:
            ended = tried(path, folder)
        except (BadInput, BadProfile) as error:
            ended = "no robot" if "has no moving joint" in str(error) else "refused"
            print(f"{path.relative_to(folder)}: {error}")
        counts[f"{tried.__name__}, {ended}"] += 1
    for ended, count in sorted(counts.items()):
        print(f"{count:5} {ended}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
