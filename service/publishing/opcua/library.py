"""asyncua, whose type annotations are wrong (its own code passes plain numbers and texts instead of other types)."""

from typing import Any, TypeAlias, cast

import asyncua

ua: Any = cast(Any, asyncua).ua
Node: TypeAlias = Any
UaServer: Any = cast(Any, asyncua).Server
