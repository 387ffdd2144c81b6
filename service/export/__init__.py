"""The identified robot in the languages of other tools: URDF, MJCF (MuJoCo) and YAML. Text in, text out."""

from service.export.files import model_files, write_model
from service.export.model import IdentifiedModel, identified_model

__all__ = ["IdentifiedModel", "identified_model", "model_files", "write_model"]
