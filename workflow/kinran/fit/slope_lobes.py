"""The lobes of a slope model: their tail, their number, and whether the diffuse normal is free."""

from dataclasses import dataclass

from kinran.fit.solver.lobes import DIFFUSE_SIZE, LOBE_SIZE


@dataclass(frozen=True)
class Lobes:
    """Lobes of a slope model.

    Attributes
    ----------
    tail
        ``gaussian`` or ``ggx``.
    count
        Number of lobes, one or two.
    bent
        Whether the diffuse term has a normal of its own; otherwise it is N.
    """

    tail: str = "ggx"
    count: int = 1
    bent: bool = True

    @property
    def size(self) -> int:
        """Number of shape parameters K of a texel."""
        return LOBE_SIZE * self.count + DIFFUSE_SIZE
