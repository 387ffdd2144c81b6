"""Results from a file of the control as frozen models; `sweepid import trace` writes their JSON."""

from service.model.results.part import Part


class Size(Part):
    """A value with one standard deviation."""

    value: float
    std: float


class OverGain(Size):
    """J/K, in s."""

    unit: str


class LoopInertia(Part):
    """On the motor side, kg m^2, and on the axis; null without the controller's gain. `over_gain`: for a closed loop.

    `band`, Hz, and number of `lines` that were used; `ended`: how the iteration ended.
    """

    motor_side: Size | None
    axis_side: Size | None
    axis_unit: str
    over_gain: OverGain | None
    delay: float | None
    band: tuple[float, float]
    lines: int
    misfit_percent: float
    converged: bool
    ended: str


class Response(Part):
    """Columns of the frequency response: Hz, real and imaginary part of output over input."""

    frequency: tuple[float, ...]
    re: tuple[float, ...]
    im: tuple[float, ...]
    coherence: tuple[float, ...] | None = None
    frequency_in_file: tuple[float, ...] | None = None


class Excitation(Part):
    """`sample_interval`, s, `bandwidth`, Hz; amplitude and offset in `unit`."""

    signal: str
    sample_interval: float
    bandwidth: float
    amplitude: float
    unit: str
    offset: float
    offset_rpm: float
    periods_averaged: int
    directions: int


class MeasuredResponse(Part):
    """A frequency response measured by the control; `inertia` from its time series and from its own spectrum."""

    kind: str
    version: str
    axis: str
    measured_at: str
    input: str
    output: str
    excitation: Excitation
    motor_to_axis: float
    torque_constant: float
    parameters: dict[str, float]
    inertia: dict[str, LoopInertia]
    speed_controller_gain: float | None
    cannot_tell: tuple[str, ...]
    frequencies_too_high_percent: float
    unread: tuple[str, ...]
    frequency_response: Response


class ByControl(Part):
    """Values computed by the control, on the motor side: kg m^2, N m s/rad, Hz."""

    motor_inertia: float
    total_inertia: float
    viscous_friction: float
    antiresonance: float | None


class SpeedController(Part):
    """Gain, N m s/rad, and reset time, s."""

    gain: float
    reset_time: float
    reference_model: bool


class ServoTuning(Part):
    """An automatic servo tuning: the inertia computed by the control, and that computed here from its response."""

    kind: str
    version: str
    axis: str
    measured_at: str
    motor_to_axis: float
    inertia: dict[str, LoopInertia]
    by_control: ByControl
    speed_controllers: tuple[SpeedController, ...]
    cannot_tell: tuple[str, ...]
    unread: tuple[str, ...]
    frequency_response: Response
