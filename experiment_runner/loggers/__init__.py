"""Results of a run for the programs that people watch their experiments in.

Each module but two is a logger; `points` defines what a logger receives, and `stream` sends it.
"""

from typing import Final

__all__ = ["LOGGERS"]

LOGGERS: Final = {
    "tensorboard": "TensorBoard",
    "wandb": "WeightsAndBiases",
    "mlflow": "MLflow",
    "trackio": "Trackio",
}
"""The class of each logger by its name, which is also that of its module and of the extra that it needs."""
