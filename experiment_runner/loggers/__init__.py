"""Loggers, which send the results of a run to experiment trackers.

Each module is a logger, except `stream`, which sends them the points of a run.
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
