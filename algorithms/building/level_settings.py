"""The settings of all level surfaces."""

from pydantic import Field

from ffmap.algorithms.base.settings import StepSettings


class LevelsSettings(StepSettings):
    """Floors, ceilings and beams that only all scans together show."""

    cell_m: float = Field(0.1, gt=0, description="Edge of the cells (m) where no other is given.")
    votes_min: int = Field(3, ge=1, description="Minimum number of votes at which a cube's label is taken as known.")
    margin_m: float = Field(0.04, gt=0, description="Half thickness (m) of a level surface: drift and scatter.")
    flat_m: float = Field(0.03, gt=0, description="Maximum height difference (m) of a level cell from its neighbours.")
    ceiling_cell_m: float = Field(0.25, gt=0, description="Edge of the cells (m) of the ceilings that scans found.")
    ceiling_reach_m: float = Field(
        1.5, ge=0, description="Maximum distance (m) over which a ceiling goes on level beyond where it was seen."
    )
    overhead_min_m: float = Field(2.2, gt=0, description="Minimum height (m) above the floor of a glimpsed ceiling.")
    overhead_width_m: float = Field(
        0.8, gt=0, description="Minimum diameter (m) of a disc in a ceiling; ducts are narrower."
    )
    overhead_gap_m: float = Field(0.3, ge=0, description="Minimum distance (m) of it from a higher ceiling.")
    mirrored_share_min: float = Field(
        0.8, gt=0, lt=1, description="Minimum share of the rays to a mirrored floor that pass a pane half way up."
    )
    mirrored_rays_min: int = Field(3, ge=1, description="Minimum number of rays to each of its cells.")
    at_pane_m: float = Field(0.1, gt=0, description="Maximum distance (m) from the pane's own returns at which they pass it.")
    slope_min: float = Field(0.15, gt=0, description="Minimum rise per metre of a sloping ceiling.")
    slope_max: float = Field(1.8, gt=0, description="Maximum rise per metre of a sloping ceiling; steeper is a wall.")
    slope_bottom_m: float = Field(1.0, gt=0, description="Minimum height (m) above the floor of a sloping ceiling.")
    window_cells: int = Field(
        5, ge=3, description="Edge (cells) of the window that a slope is fitted to, and in which floors meet in a step."
    )
    slope_share_min: float = Field(0.6, gt=0, le=1, description="Minimum share of a window's cells that hold returns.")
    slope_rms_max_m: float = Field(0.025, gt=0, description="Maximum RMS distance (m) of returns from their plane.")
    slope_reach_m: float = Field(
        0.25, ge=0, description="Distance (m) over which a sloping ceiling goes on beyond the windows, up to its walls."
    )
    raised_min_m: float = Field(
        0.06, gt=0, description="Minimum height (m) of a step or platform above the floor beside it; carpets are lower."
    )
    raised_max_m: float = Field(
        0.30, gt=0, description="Maximum height (m) of a step or platform above the floor beside it; seats are higher."
    )
    raised_width_m: float = Field(1.2, gt=0, description="Minimum diameter (m) of a disc in a platform.")
    beyond_cell_m: float = Field(0.3, gt=0, description="Edge of the cells (m) for floor beyond what scans found.")
    beyond_level_m: float = Field(0.05, gt=0, description="Maximum height difference (m) of it from the nearest floor.")
    beyond_width_m: float = Field(0.9, gt=0, description="Minimum diameter (m) of a disc within such floor.")
    drop_min_m: float = Field(0.08, gt=0, description="Minimum height (m) of what hangs below a ceiling.")
    narrow_beside_m: float = Field(
        0.4, gt=0, description="Within this distance (m) a higher ceiling makes a narrow surface no room's ceiling."
    )
    ceiling_edge_m: float = Field(0.3, ge=0, description="Width (m) of a ceiling's edge, where another may begin.")
    drop_reach_m: float = Field(
        0.8, gt=0, description="Maximum distance (m) of what hangs below a ceiling to where that is seen."
    )
    drop_edge_m: float = Field(
        0.2, gt=0, description="Distance (m) from its sides within which a ceiling that is not level is to be reached by them."
    )
    drop_max_m: float = Field(1.5, gt=0, description="Maximum height (m) of a beam, a coffer or a rooflight's shaft.")
    headroom_m: float = Field(
        1.9, gt=0, description="Minimum height (m) above the floor of what is built below a ceiling."
    )
    drop_gap_m: float = Field(0.15, gt=0, description="Maximum height (m) between the returns of one side of a beam.")
    drop_sides_min: int = Field(5, ge=1, description="Minimum number of cells that show a beam's sides.")
    drop_closed_min: float = Field(
        0.6, gt=0, le=1, description="Minimum share of them where the side reaches the ceiling."
    )
    drop_deep_m: float = Field(
        0.4, gt=0, description="Minimum depth (m) of what hangs, not a wall, though scans take its side for one."
    )
    lamp_max_m: float = Field(
        2.0, gt=0, description="Maximum length (m) of lamps: what is longer is built, though no wall is seen to hold it."
    )
    slit_max_m: float = Field(
        0.65, gt=0, description="Maximum distance (m) from its wall of a duct that runs along it."
    )
    below_floor_m: float = Field(
        0.4, gt=0, description="What stands lower than this (m) below the nearest floor belongs to the storey below."
    )
