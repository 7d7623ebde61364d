"""Settings of the docking station."""

from pydantic import Field

from comparisons.config import ExtensionConfig


class DockingConfig(ExtensionConfig):
    """A docking station that the vehicle sees with a direction, by an exact simulated sensor."""

    extension = "tests.comparisons.toy_extension.extension:Docking"
    x_m: float = Field(0.0, description="of the station, east")
    y_m: float = Field(0.0, description="of the station, north")
    reach_m: float = Field(15.0, gt=0.0, description="from where it is seen")
    bias_m: float = Field(0.0, description="added to every second distance, to be found out")
