"""Reuses the fit of an axis whose inputs have not changed since an earlier revision.

A revision adds a sweep of one axis; the fits of the others would give the same numbers as before. The key is a
digest of every input, so a cached result is equal to the computed one to the last digit.
"""

import pickle
from collections import OrderedDict
from collections.abc import Callable
from hashlib import sha256
from threading import Lock
from typing import ParamSpec

from service.identification.axis.axis_estimate import AxisEstimate

P = ParamSpec("P")

KEPT = 8  # results, of a few MB at most each: the axes of one robot

_kept: OrderedDict[bytes, AxisEstimate] = OrderedDict()
_lock = Lock()


def unchanged_or(compute: Callable[P, AxisEstimate], *inputs: P.args, **named: P.kwargs) -> AxisEstimate:
    """`compute(*inputs)`, or its earlier result in this process for equal inputs. Raises the errors of `compute`."""
    key = sha256(pickle.dumps((compute.__qualname__, inputs, named), protocol=5)).digest()
    with _lock:
        found = _kept.get(key)
        if found is not None:
            _kept.move_to_end(key)
            return found
    result = compute(*inputs, **named)
    with _lock:
        _kept[key] = result
        while len(_kept) > KEPT:
            _kept.popitem(last=False)
    return result
