"""The paper's Eq. 3: by its four steps, and jointly by non-linear least squares."""

from kinran.baselines import takeda_joint
from kinran.chart.method import Method
from kinran.chart.trial import Trial
from kinran.fit import takeda
from kinran.fit.channels import Fitted
from kinran.fit.takeda import TakedaFit
from kinran.fit.tolerances import tolerances


def four_steps(trial: Trial) -> TakedaFit:
    """The four steps, as the pipeline takes them."""
    return takeda.four_steps(trial.samples, *tolerances(trial.lights))


def _joint(trial: Trial) -> Fitted:
    return takeda_joint.fit(trial.samples, four_steps(trial))


METHODS = (
    Method("four steps", "paper", four_steps, 4, True),
    Method("Eq. 3, joint", "paper", _joint, 8, True),
)
