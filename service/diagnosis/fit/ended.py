"""How the searches of the fit ended. One that used up its steps is reported with its axis (`unfinished`)."""

from enum import Enum


class Ended(Enum):
    """How a search ended."""

    SETTLED = "a further step gains too little to matter"
    AT_REST = "no step, also not a shortened or damped one, lowers the cost"
    UNFINISHED = "the result still changes in the last one"
