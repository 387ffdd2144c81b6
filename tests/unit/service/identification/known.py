"""Known effects as a model's document has them."""

from typing import Any

from service.identification.axis.known_effects import KnownEffects, known_effects
from service.model.results.effect import KnownModel, StoredModel

Parameters = dict[str, tuple[float, float]]  # parameter: value, std


def model(torques: str = "recorded", **axes: dict[str, Parameters]) -> dict[str, Any]:
    """The document of a model: by joint the effects with their parameters."""
    return {
        "axes": {
            joint: {
                "effects": [
                    {
                        "effect": name,
                        "parameters": {key: {"value": v, "std": s, "unit": "SI"} for key, (v, s) in told.items()},
                    }
                    for name, told in effects.items()
                ],
                "fit": {"torques": torques},
            }
            for joint, effects in axes.items()
        }
    }


def known(torques: str = "recorded", **axes: dict[str, Parameters]) -> KnownEffects:
    """The same, read."""
    return read(model(torques, **axes), *axes)


def read(document: dict[str, Any], *joints: str) -> KnownEffects:
    """Of these joints."""
    return known_effects(KnownModel.read(document, "model"), joints, StoredModel(id=7, revision=1))
