"""Loggers, which send the results of a run to experiment trackers.

Each module is a logger, except `points`, the data that a logger receives, and `stream`, which sends it.
"""

from typing import Final

__all__ = ["LOGGERS"]

LOGGERS: Final = {
    "tensorboard": "TensorBoard",
    "wandb": "WeightsAndBiases",
    "mlflow": "MLflow",
    "trackio": "Trackio",
}
"""The class of each logger by its name, which is also the name of its module and of its extra."""
