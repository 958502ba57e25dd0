"""The paper's Eq. 3: by its four steps, and jointly by non-linear least squares."""

from kinran.compare.baselines import takeda_joint
from kinran.compare.method import Method
from kinran.compare.trial import Trial
from kinran.data.light import half_steps
from kinran.fit import takeda
from kinran.fit.fitted_model import Fitted
from kinran.fit.takeda import TakedaFit


def four_steps(trial: Trial) -> TakedaFit:
    """The four steps, as the pipeline takes them."""
    return takeda.four_steps(trial.samples, *half_steps(trial.lights))


def _joint(trial: Trial) -> Fitted:
    return takeda_joint.fit(trial.samples, four_steps(trial))


METHODS = (
    Method("four steps", "paper", four_steps, 4, True),
    Method("Eq. 3, joint", "paper", _joint, 8, True),
)
