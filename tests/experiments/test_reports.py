"""Reports: their content from a hop computed here, and the page in a real browser."""

import re
from html.parser import HTMLParser
from pathlib import Path

import mujoco
import numpy as np
import plotly.graph_objects as go
import pytest

from experiments.errors import UserError
from experiments.parameter_file import now, write_parameters
from experiments.reports.jump import write_jump_report
from experiments.reports.numbers import number
from experiments.reports.page import Card, Cards, Code, Figure, Section, Table, Text, render_report, write_report
from experiments.reports.playback import Playback, Track, frames, leg_points
from experiments.reports.recording import History, JumpRecord, Sensitivity, saturations
from mjx_starleth.mjcf import mjcf
from mjx_starleth.names import FORE_SIGN, LEFT_SIGN
from mjx_starleth.numbers import load_numbers
from mjx_starleth.terrain import plane

NUMBERS = load_numbers()
PERIOD = 2.5e-3
MASS, GRAVITY = 26.82, 9.81
MAX_PAGE = 6_000_000  # bytes; plotly.js alone has 4.8 million
CROUCH, LAUNCH, STANCE = 0.26, 0.48, 0.42  # torso heights, m


def hop(drive: str, speed: float) -> JumpRecord:
    """A straight hop that leaves the ground at `speed`: quintic push, free flight, damped landing, feet under hips."""
    time = np.arange(960) * PERIOD
    height, phase, foot_z = _course(time, speed)
    acceleration = np.gradient(np.gradient(height, PERIOD), PERIOD)
    grounded = phase != 2
    q, foot = _legs(height, foot_z)
    u = np.zeros((len(time), 18))
    u[:, 2] = np.gradient(height, PERIOD)
    u[:, 6:] = np.gradient(q[:, 7:], PERIOD, axis=0)
    force = np.zeros((len(time), 4, 3))
    force[..., 2] = (np.clip(MASS * (GRAVITY + acceleration), 0, 2500) * grounded / 4)[:, None]
    force[..., 0] = 0.3 * force[..., 2] * np.array(FORE_SIGN) * np.sin(9 * time)[:, None]
    torque = _torques(q, foot, force)
    current = np.abs(torque) / (100 * 0.0276) + 0.02 * np.abs(u[:, 6:])
    wanted = u[:, 6:] * 1.25 + 2 * np.sin(60 * time)[:, None] * grounded[:, None]
    commanded = np.clip(wanted, -10, 10)
    power = 180.0 / np.maximum(np.abs(torque), 1e-9)
    commanded = np.clip(commanded, -power, power)
    return JumpRecord(
        drive=drive,
        time=time,
        q=q,
        u=u,
        foot_position=foot,
        contact_force=force,
        joint_torque=torque,
        wanted_velocity=wanted,
        commanded_velocity=commanded,
        motor_velocity=u[:, 6:],
        current=np.clip(current, 0, 9.4),
        voltage=np.clip(0.386 * current + 2.76 * np.abs(u[:, 6:]), 0, 48),
        desired_height=np.where(phase < 2, height + 0.02 * (phase == 1), np.nan),
        phase=phase,
    )


def _course(time, speed):
    """Torso height, phase and height of the foot centres."""
    radius, start, push = NUMBERS.bodies.foot.radius, 0.3, 0.4
    end = start + push
    # quintic from rest at CROUCH to LAUNCH with `speed`, both without acceleration
    rise = LAUNCH - CROUCH
    s = np.clip((time - start) / push, 0, 1)
    v = speed * push
    quintic = (10 * rise - 4 * v) * s**3 + (-15 * rise + 7 * v) * s**4 + (6 * rise - 3 * v) * s**5
    flight = time - end
    air = 2 * speed / GRAVITY
    ballistic = LAUNCH + speed * flight - GRAVITY / 2 * flight**2
    since = np.maximum(flight - air, 0)
    w = 14.0  # rad/s, critically damped
    settle = STANCE + np.exp(-w * since) * ((LAUNCH - STANCE) + (-speed + w * (LAUNCH - STANCE)) * since)
    height = np.where(flight < 0, CROUCH + quintic, np.where(flight < air, ballistic, settle))
    phase = np.select([time < start, flight < 0, flight < air, since < 0.4], [0, 1, 2, 3], 4)
    tuck = np.sin(np.pi * np.clip(flight / air, 0, 1)) ** 2
    foot = np.where(phase == 2, height - LAUNCH + radius + 0.14 * tuck, radius)
    return height, phase, foot


def _legs(height, foot_z):
    """Coordinates (T, 19) and feet (T, 4, 3) with every foot under its hip, by the law of cosines."""
    b = NUMBERS.bodies
    a, c = b.thigh.length, b.foot.centre_from_knee
    reach = np.clip(height - b.hip.length - foot_z, 0.05, 0.999 * (a + c))
    bend = np.arccos((reach**2 - a**2 - c**2) / (2 * a * c))
    hip = np.arctan2(c * np.sin(bend), a + c * np.cos(bend))
    q = np.zeros((len(height), 19))
    q[:, 2], q[:, 3] = height, 1
    foot = np.zeros((len(height), 4, 3))
    for k, (fore, left) in enumerate(zip(FORE_SIGN, LEFT_SIGN, strict=True)):
        q[:, 8 + 3 * k], q[:, 9 + 3 * k] = fore * hip, -fore * bend
        foot[:, k] = np.stack([height * 0 + fore * b.haa_in_torso.x, height * 0 + left * b.haa_in_torso.y, foot_z], -1)
    return q, foot


def _torques(q, foot, force):
    """Static joint torques (T, 12): each joint holds the moment of its foot's force."""
    points = leg_points(q, NUMBERS)
    torque = np.zeros((len(q), 12))
    for joint, pivot in ((1, points[:, :, 0]), (2, points[:, :, 1])):
        arm = foot - pivot
        torque[:, joint::3] = -(arm[..., 2] * force[..., 0] - arm[..., 0] * force[..., 2])
    return torque


def history(stages=(60, 80, 110)) -> History:
    """A search that converges, with a step up at each stage."""
    rng = np.random.default_rng(0)
    stage = np.repeat(np.arange(3), stages)
    decay = np.concatenate([np.exp(-np.arange(n) / 25) for n in stages])
    floor = np.array([-9.0, -7.6, -6.9])[stage]
    mean = floor + 3 * decay + 0.2 * rng.random(len(stage))
    std = 0.15 + 1.2 * decay
    best = mean - 1.3 * std * rng.random(len(stage))
    best[3], mean[3] = np.inf, np.inf  # a generation that fell
    names = ("ideal drive", "limits", "full drive")
    return History(best, mean, stage, names, 15, std=std, sigma=0.02 + 0.25 * decay)


def parameter_file(path: Path, record: JumpRecord):
    rng = np.random.default_rng(1)
    names = [f"height_knot_{k}" for k in range(1, 9)] + [f"foot_height_{k}" for k in range(1, 4)]
    rows = [
        {"name": n, "value": v, "unit": "m", "low": 0.22, "high": 0.55}
        for n, v in zip(names, 0.22 + 0.33 * rng.random(11), strict=True)
    ]
    rows.append({"name": "initial_height", "value": 0.24, "unit": "m", "low": 0.24, "high": 0.42})
    rows.append({"name": "vertical_damping", "value": 132.0, "unit": "N s/m", "low": 0.0, "high": 400.0})
    spread = {"mean": record.apex - 0.012, "std": 0.011, "low": 0.68, "high": 0.75}
    return write_parameters(
        path,
        task="squat_jump",
        robot="starleth",
        model_hash="0123456789abcdef",
        parameters=rows,
        metrics={
            "apex_height": {"value": record.apex, "unit": "m", "spread": spread},
            "landed": {"value": True, "unit": "-", "spread": {"mean": 0.984, "std": 0.12, "low": 0.0, "high": 1.0}},
            "rebound_time": {"value": 0.0, "unit": "s"},
            "slip_distance": {"value": 0.0042, "unit": "m"},
            "cost": {"value": -6.87, "unit": "-"},
        },
        cost_terms={"apex": -7.6, "leg_length": 0.34, "slip": 0.004, "rebound": 0.0, "tracking": 0.21, "cone": 0.17},
        perturbed={"trials": 64, "seed": 3, "perturbations": {"link_mass": "normal, 3 %", "gear_friction": "±30 %"}},
        drive="full",
        seed=7,
        search={"generations": 250, "population": 15, "sigma": 0.25, "stages": "ideal drive, limits, full drive"},
        versions={"starleth": "0.1.0", "jax": "0.10.2", "mujoco": "4.0.0", "python": "3.11.7"},
        created=now(),
        command="starleth replay runs/squat_jump/parameters.json --drive full",
    )  # fmt: skip


SENSITIVITIES = (
    Sensitivity("gear friction", "-50 %", "+50 %", 0.024, -0.027),
    Sensitivity("knee spring", "-10 %", "+10 %", 0.008, -0.009),
    Sensitivity("current limit", "-10 %", "+10 %", -0.019, 0.011),
)


@pytest.fixture(scope="module")
def jump():
    return hop("full", 2.3)


@pytest.fixture(scope="module")
def report(tmp_path_factory, jump) -> Path:
    folder = tmp_path_factory.mktemp("report")
    file = parameter_file(folder / "parameters.json", jump)
    write_jump_report(
        folder / "report.html", file, NUMBERS, jump,
        ideal=hop("ideal", 2.75), history=history(), sensitivities=SENSITIVITIES,
    )  # fmt: skip
    return folder / "report.html"


# ---- what the page is made from


def test_the_playback_puts_legs_where_mujoco_puts_them():
    model = mujoco.MjModel.from_xml_string(mjcf(NUMBERS))
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    q = rng.normal(size=(20, 19)) * 0.7
    q[:, 3:7] /= np.linalg.norm(q[:, 3:7], axis=1, keepdims=True)
    points = leg_points(q, NUMBERS)
    for row, found in zip(q, points, strict=True):
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        for k, leg in enumerate(("LF", "RF", "LH", "RH")):
            expected = [data.body(f"{leg}_THIGH").xpos, data.body(f"{leg}_SHANK").xpos, data.site(f"{leg}_foot").xpos]
            np.testing.assert_allclose(found[k], expected, atol=1e-12)


def test_the_playback_can_interpolate_between_its_frames(jump):
    q = jump.q.copy()
    angle = np.linspace(0, 7, len(q))  # a somersault: the quaternion's sign flips on the way
    q[:, 3], q[:, 5] = np.cos(angle / 2), np.sin(angle / 2)
    q[::3, 3:7] *= -1
    packed = frames(Track("somersault", q, jump.contact_force), NUMBERS)
    assert packed.shape == (960, 55) and packed.dtype == np.float32
    assert np.abs(np.diff(packed[:, 3:7], axis=0)).max() < 0.01
    np.testing.assert_allclose(np.abs((packed[:, 3:7] * q[:, 3:7]).sum(1)), 1, atol=1e-6)
    np.testing.assert_allclose(packed[:, 43:], jump.contact_force.reshape(-1, 12), rtol=1e-6)


def test_saturations_are_told_apart(jump):
    still = {name: np.zeros((3, 12)) for name in ("wanted_velocity", "commanded_velocity", "current", "voltage")}
    cut = {name: getattr(jump, name)[:3] for name in jump.__dataclass_fields__ if name != "drive"} | still
    cut["wanted_velocity"][0, :3] = [12.0, -12.0, 9.0]
    cut["commanded_velocity"][0, :3] = [10.0, -4.0, 9.0]  # at the speed limit, at the power limit, free
    cut["current"][1, 4] = -9.4
    cut["voltage"][2, 5] = 48.0
    found = saturations(JumpRecord(drive="full", **cut), NUMBERS)
    where = {name: [tuple(map(int, place)) for place in np.argwhere(mask)] for name, mask in found.items()}
    assert where == {"speed": [(0, 0)], "power": [(0, 1)], "current": [(1, 4)], "voltage": [(2, 5)]}


def test_best_so_far_starts_anew_in_each_stage_and_skips_what_fell():
    best = np.array([np.inf, 3.0, 1, 2, 9, 8, np.inf])
    h = History(best, np.zeros(7), np.array([0, 0, 0, 0, 1, 1, 1]), ("a", "b"), 15)
    np.testing.assert_array_equal(h.best_so_far, [np.nan, 3, 1, 1, 9, 8, 8])


@pytest.mark.parametrize(("name", "value"), [("q", np.zeros((960, 18))), ("current", np.full((960, 12), np.nan))])
def test_a_recording_of_the_wrong_form_is_refused(jump, name, value):
    fields = {field: getattr(jump, field) for field in jump.__dataclass_fields__}
    with pytest.raises(ValueError, match=f"{name} of a recording"):
        JumpRecord(**fields | {name: value})


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.4567, "0.457"),
        (-3, "−3"),
        (0, "0"),
        (1234.5, "1234"),
        (2.5e-5, "2.5·10⁻⁵"),
        (float("nan"), "–"),
        (120, "120"),
    ],
)
def test_numbers_for_people(value, text):
    assert number(value) == text


# ---- the page as a file

HOSTILE = "</script><script>window.pwned = 1</script><img src=x onerror='window.pwned = 2'>&\u2028"


def hostile_page() -> str:
    figure = go.Figure(go.Scatter(x=[0, 1], y=[1, 2], name=HOSTILE))
    blocks = [
        Text(HOSTILE),
        Cards([Card(HOSTILE, HOSTILE, HOSTILE, HOSTILE)]),
        Table([HOSTILE], [[HOSTILE]], HOSTILE),
        Code(HOSTILE),
        Figure(figure, HOSTILE),
        Playback([Track(HOSTILE, *[hop("full", 2.0).q[:4], np.zeros((4, 4, 3))])] * 2, PERIOD, NUMBERS, HOSTILE,
                 spans=[(HOSTILE, 0, 1)]),
    ]  # fmt: skip
    return render_report(HOSTILE, HOSTILE, [Section(HOSTILE, blocks)] * 3)


class References(HTMLParser):
    """Every address that a page would fetch or link to, in tags and style sheets."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.found: list[str] = []
        self.scripts = 0
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.scripts += tag == "script"
        for name, value in attrs:
            if name in ("src", "href", "srcset", "data", "action", "poster", "background", "xlink:href"):
                self.found.append(value or "")
            self.found += re.findall(r"url\(([^)]*)\)", value or "") if name == "style" else []

    def handle_data(self, data):
        if self.lasttag == "style":
            self.found += re.findall(r"url\(([^)]*)\)|@import\s+(\S+)", data)


def test_the_page_refers_to_nothing_outside_itself(report):
    page = References(report.read_text())
    assert len(page.found) > 5  # the table of contents at least
    assert all(address.startswith(("#", "data:")) for address in page.found), page.found


def test_the_page_is_one_file_of_bounded_weight(report):
    assert report.stat().st_size < MAX_PAGE
    assert sorted(p.name for p in report.parent.iterdir()) == ["parameters.json", "report.html"]


def test_text_cannot_leave_its_element():
    page = References(hostile_page())
    assert page.scripts == References(render_report("", "", [Section("", [])] * 3)).scripts + 3 * 2 + 1 + 6
    assert all(address.startswith(("#", "data:")) for address in page.found)


def test_a_report_that_cannot_be_written_is_one_sentence(tmp_path):
    with pytest.raises(UserError, match="cannot write"):
        write_report(tmp_path / "missing" / "report.html", "t", "s", [Section("a", [Text("b")])])


def test_a_jump_that_never_leaves_the_ground_has_a_report_too(tmp_path, jump):
    n = 40
    fields = {name: getattr(jump, name)[:n] for name in jump.__dataclass_fields__ if name != "drive"}
    file = parameter_file(tmp_path / "parameters.json", jump)
    write_jump_report(tmp_path / "report.html", file, NUMBERS, JumpRecord(drive="cheap", **fields))
    text = (tmp_path / "report.html").read_text()
    assert "cheap drive" in text and "On the ideal drive" not in text


# ---- the page in a browser


@pytest.fixture
def page(chromium, report):
    """The jump's report, drawn; loaded only if the browser shows something else."""
    if chromium.evaluate("location.href") != report.as_uri():
        chromium.open(report)
        chromium.wait_for("document.documentElement.dataset.figures")
    return chromium


def test_the_report_in_a_browser(page, report, jump):
    assert page.problems == []
    assert page.requests == [report.as_uri()]
    drawn = page.evaluate("[...document.querySelectorAll('.plot')].map(p => p.querySelectorAll('.trace').length)")
    assert len(drawn) == 7 and min(drawn) > 0, drawn
    assert page.evaluate("document.querySelectorAll('figcaption b').length") == 13
    # the numbers that the figures were drawn from, back from the page
    torso = page.evaluate("Array.from(document.querySelector('.plot')._fullData[1].y)")
    np.testing.assert_allclose(torso, jump.q[:, 2], atol=1e-6)
    reached = page.evaluate(
        "Array.from(document.querySelectorAll('.plot')[1]._fullData.filter(t => t.name === 'reached')[2].y)"
    )
    np.testing.assert_allclose(reached, jump.motor_velocity[: len(reached), 2], atol=1e-5)


def state(chromium) -> dict:
    return chromium.evaluate("({...document.querySelector('.playback').dataset})")


def test_the_playback_plays_stops_and_seeks(chromium, report, jump):
    chromium.open(report)
    chromium.wait_for("document.documentElement.dataset.figures")
    apex = int(jump.q[:, 2].argmax())
    assert abs(float(state(chromium)["time"]) - jump.time[apex]) < 2e-3  # the poster
    assert float(state(chromium)["height"]) == pytest.approx(jump.apex, abs=1e-3)

    chromium.evaluate("document.querySelector('.playback .play').click()")
    chromium.wait_for("+document.querySelector('.playback').dataset.time > 0.1")
    now = state(chromium)
    assert now["state"] == "playing"
    at = np.interp(float(now["time"]), jump.time, jump.q[:, 2])
    assert float(now["height"]) == pytest.approx(at, abs=2e-3)
    chromium.evaluate("document.querySelector('.playback .play').click()")
    stopped = state(chromium)
    assert stopped["state"] == "paused"
    chromium.evaluate("new Promise(done => setTimeout(done, 100))")
    assert state(chromium)["time"] == stopped["time"]

    # a click on a time axis, and the last moment played: it stops there by itself
    chromium.evaluate("document.querySelector('.plot').emit('plotly_click', {points: [{x: 0.5}]})")
    assert float(state(chromium)["time"]) == 0.5
    chromium.evaluate("document.querySelector('.playback').dispatchEvent(new CustomEvent('seek', {detail: 2.3}))")
    chromium.evaluate("document.querySelector('.playback .play').click()")
    chromium.wait_for("document.querySelector('.playback').dataset.state === 'paused'")
    assert float(state(chromium)["time"]) == pytest.approx(jump.time[-1], abs=2 * PERIOD)


PICTURE = """(() => {
  const c = document.querySelector('.playback .stage canvas');
  const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
  let rows = [], sum = 0;
  for (let y = 0; y < c.height; y++) for (let x = 0; x < c.width; x++) {
    const k = 4 * (y * c.width + x);
    sum = (sum * 31 + d[k] + 3 * d[k + 1] + 7 * d[k + 2]) % 4294967291;
    if (d[k + 3] > 250 && d[k] + d[k + 1] + d[k + 2] < 260) rows.push(y);  // the robot is the darkest thing there
  }
  return {sum, dark: rows.length, top: rows.length ? rows[0] / c.height : 1};
})()"""


def test_the_picture_shows_the_robot_where_it_is(page):
    seek = "document.querySelector('.playback').dispatchEvent(new CustomEvent('seek', {detail: %s}))"
    page.evaluate(seek % 0.1)
    low = page.evaluate(PICTURE)
    page.evaluate(seek % 0.93)
    high = page.evaluate(PICTURE)
    assert low["dark"] > 2000 and high["dark"] > 2000
    assert high["top"] < low["top"] - 0.15  # 0.49 m higher in a picture that shows about 2 m
    page.evaluate("document.querySelector('.playback .ghost').click()")
    assert page.evaluate(PICTURE)["sum"] != high["sum"]


def test_dragging_turns_the_view_and_scrubs_the_time(page):

    def drag(selector, start, end):
        page.evaluate(f"document.querySelector('{selector}').scrollIntoView({{block: 'center', behavior: 'instant'}})")
        box = page.evaluate(f"document.querySelector('{selector}').getBoundingClientRect().toJSON()")
        where = [(box["x"] + share * box["width"], box["y"] + box["height"] / 2) for share in (start, end)]
        for kind, (x, y) in zip(("mousePressed", "mouseMoved", "mouseReleased"), (*where, where[1])):
            page.send("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1)

    before = page.evaluate(PICTURE)["sum"]
    drag(".playback .stage canvas", 0.3, 0.6)
    assert page.evaluate(PICTURE)["sum"] != before
    drag(".playback .time", 0.2, 0.9)
    assert 2.0 < float(state(page)["time"]) < 2.3


def test_the_page_changes_between_light_and_dark(page):
    colours = (
        "[getComputedStyle(document.body).backgroundColor, document.querySelector('.plot')._fullLayout.font.color]"
    )
    before = page.evaluate(colours)
    page.problems.clear()  # Chromium remarks on the pictures that the tests before took
    page.evaluate("document.getElementById('theme').click()")
    page.wait_for(f"{colours}.every((c, n) => c !== {before!r}[n])")
    assert page.problems == []


def test_hostile_text_runs_nothing(chromium, tmp_path):
    (tmp_path / "page.html").write_text(hostile_page())
    chromium.open(tmp_path / "page.html")
    chromium.wait_for("document.documentElement.dataset.figures")
    assert chromium.evaluate("window.pwned === undefined")
    assert chromium.problems == []
    assert len(chromium.requests) == 1
    assert chromium.evaluate("document.querySelector('h1').textContent").strip() == HOSTILE.strip()


def test_slopes_obstacles_and_a_missing_ghost_are_drawn(chromium, tmp_path, jump):
    ground = plane((0.2, 0.1, 1.0), 0.0, obstacles=2, patches=1)
    ground = ground._replace(obstacle_height=np.array([0.05, 0.1]), obstacle_flank=np.array([0.01, 0.3]),
                             patch_half_size=np.full((1, 2), 0.3), patch_friction=np.array([0.4]))  # fmt: skip
    block = Playback([Track("one", jump.q, jump.contact_force)], PERIOD, NUMBERS, "On a slope.", terrain=ground)
    write_report(tmp_path / "slope.html", "Slope", "", [Section("Motion", [block])])
    chromium.open(tmp_path / "slope.html")
    chromium.wait_for("document.querySelector('.playback').dataset.time")
    assert chromium.problems == []
    assert chromium.evaluate(PICTURE)["dark"] > 2000
    # above the slope, measured straight down
    assert float(state(chromium)["height"]) == pytest.approx(jump.q[0, 2], abs=1e-3)


def test_the_page_may_not_reach_the_network(chromium, tmp_path):
    """Should some script ever try: the content security policy stops it."""
    write_report(tmp_path / "page.html", "Page", "", [Section("Text", [Text("…")])])
    chromium.open(tmp_path / "page.html")
    tried = chromium.evaluate("fetch('http://127.0.0.1:9/').then(() => 'reached', error => error.name)")
    assert tried == "TypeError"
    assert any("Content Security Policy" in problem for problem in chromium.problems)


def test_a_playback_of_unequal_tracks_is_refused(jump):
    tracks = [Track("a", jump.q, jump.contact_force), Track("b", jump.q[:9], jump.contact_force[:9])]
    with pytest.raises(ValueError, match="same number of samples"):
        render_report("", "", [Section("", [Playback(tracks, PERIOD, NUMBERS, "")])])
