"""All planted defects."""

from __future__ import annotations

from comparisons.adapters.defects import algebra, data, models, noise
from comparisons.adapters.defects.defect import Defect

REGISTRY: tuple[Defect, ...] = (
    *algebra.DEFECTS,
    *models.DEFECTS,
    *noise.DEFECTS,
    *data.DEFECTS,
)
