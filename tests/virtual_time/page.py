"""What a person reads on the page of a STOP, by the page's own script under Node.js."""

import json
import os
import shutil
from collections.abc import Sequence
from dataclasses import asdict
from importlib.resources import files
from pathlib import Path

from tests.npm import NODE
from tests.virtual_time.stops import ANSWERED, HEARD, Stop

SCRIPT = Path(__file__).with_name("page.mjs")
MODULE = Path(str(files("service.web.hmi"))) / "static" / "pressed.js"


def check_page(stops: Sequence[Stop], folder: Path) -> None:
    """AssertionError if a person read something that is not so, or nothing definite after `ANSWERED` s.

    Node runs in real time: nothing of `subprocess` is used, which knows virtual time only.
    """
    module, presses, place = folder / "pressed.mjs", folder / "presses.json", folder / "told.json"
    shutil.copy(MODULE, module)
    wanted = [{"until": ANSWERED, "answers": [asdict(answer) for answer in stop.answers]} for stop in stops]
    presses.write_text(json.dumps(wanted), "utf-8")
    assert os.spawnv(os.P_WAIT, NODE, [str(each) for each in (NODE, SCRIPT, module, presses, place)]) == 0
    for stop, read in zip(stops, json.loads(place.read_text("utf-8")), strict=True):
        moving = {joint for joint, why in stop.truth.items() if why}
        last = read[-1]
        for told in read:  # nothing gets energy after a confirmation: what stands at the end may have stood before
            assert told["text"] != "stop.confirmed" or not moving, (told, stop)
        assert last["text"] in ("stop.confirmed", "stop.unconfirmed", "stop.late", "stop.refused"), (last, stop)
        assert last["text"] != "stop.unconfirmed" or moving <= {*last["axes"]}, (last, stop)
        if stop.condition in HEARD:
            assert last["text"] == "stop.confirmed", ("false alarm", last, stop)
