"""The identified robot in the formats of other tools: URDF, MJCF (MuJoCo) and YAML. Text in, text out."""

from service.formats.export.files import model_files, write_model
from service.formats.export.model import IdentifiedModel, identified_model, model_of

__all__ = ["IdentifiedModel", "identified_model", "model_files", "model_of", "write_model"]
