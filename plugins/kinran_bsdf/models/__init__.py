"""The reflection models by name: the reference that the fit, the relighting and the renderer share.

The modelled quantity is T = f_r cos θ_l in 1/sr, and a lobe G is 1 at its centre. At the measured view V = N:

    T = Σ amplitude · colour · G(h) + amplitude_d · colour_d · max(0, l_z + x l_x + y l_y)

Other views are extrapolated (`Model.lobe`, `diffuse_lift`). A model is a class in a file of its own and a
place in `MODELS`; compiled twins (the solver's lobes, `native/models.h`) are held to it by tests.
"""

from kinran_bsdf.models.lambert import Lambert
from kinran_bsdf.models.model import Model
from kinran_bsdf.models.slope import TAILS, Slope
from kinran_bsdf.models.takeda2008 import Takeda2008

__all__ = ["MODELS", "TAILS", "Lambert", "Model", "Slope", "Takeda2008"]

MODELS: dict[str, type[Model]] = {model.name: model for model in (Takeda2008, Slope, Lambert)}
"""The models by name."""
