// The page: builds itself for the ring, and shows the pictures that the service sends.

import { RingChart, TREND_SPAN, TrendChart } from "./charts.js";
import { Link } from "./link.js";
import { at, orbitOld, say, showState } from "./state.js";
import { ago, count, duration, moment, quantity, signed, some, timeOfDay, UNKNOWN } from "./words.js";

const LOOK = 250; // how often to look whether the picture is still live [ms]
const TOLD = 5; // how often to tell the charts in words [s]
const trend = [];
let layout = null, charts = null, picture = null, restarted = 0, told = 0, drawing = false;

function greet(message) {
  const own = document.querySelector("meta[name=assets]").content;
  if (message.assets !== own && sessionStorage.getItem("assets") !== message.assets) {
    sessionStorage.setItem("assets", message.assets); // once: the files may be those of a cache
    location.reload();
    return;
  }
  if (JSON.stringify(layout) !== JSON.stringify(message.layout)) {
    layout = message.layout;
    trend.length = 0;
    build();
  }
  const first = message.trend.length ? message.trend[0][0] : Infinity;
  const older = trend.filter((point) => point[0] < first);
  trend.splice(0, trend.length, ...older, ...message.trend);
}

function take(its) {
  if (picture && picture.started !== its.started) restarted = its.time;
  picture = its;
  remember(its);
  if (document.hidden) show(); // no frames come, but what stands here must not be older
  else if (!drawing) {
    drawing = true;
    requestAnimationFrame(() => { drawing = false; show(); });
  }
}

function remember(its) {
  const last = trend.at(-1);
  if (last && its.time - last[0] < 0.95) return;
  const rms = its.alive ? its.rms_peak_um : {};
  trend.push([its.time, its.floor_um, ...[...layout.planes].map((plane) => rms[plane] ?? null)]);
  while (trend[0][0] < its.time - TREND_SPAN) trend.shift();
}

function show() {
  if (!picture || !charts) return;
  figures(picture);
  along(picture);
  gap(picture);
  policy(picture);
  loop(picture);
  measurement(picture);
  happened(picture);
  look(true);
}

function look(fresh = false) {
  showState(picture, link, restarted, layout);
  if (!picture || !charts) return;
  const since = link.live ? 0 : Math.max(0, link.age); // what is not live goes on to age
  const age = picture.tick_age + since;
  say("tick-age", age < 1 ? "less than a second ago" : ago(age));
  if (fresh || since) charts.trend.set(trend, picture.time + since, picture.floor_source === "configuration");
}

function make(tag, properties = {}, ...children) {
  const element = Object.assign(document.createElement(tag), properties);
  element.append(...children);
  return element;
}

function tile(id, name) {
  return make("div", { className: "tile" }, make("h2", { textContent: name }),
    make("p", { id, className: "value", textContent: UNKNOWN }),
    make("p", { id: `${id}-more`, className: "quiet" }));
}

function chart(id, title) {
  const canvas = make("canvas", { id });
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", title);
  const readout = make("span", { id: `${id}-readout`, className: "readout" });
  const caption = make("figcaption", {}, make("h2", { textContent: title }), readout);
  at("charts").append(make("figure", {}, caption, canvas, make("p", { id: `${id}-note`, className: "note" })));
  return [canvas, readout];
}

// Vectors are x first, then y; counts says how many each has, if not as many.
function parts(list, counts) {
  if (layout.planes.length === 1) return [list];
  const first = counts.length ? counts[0] : list.length / 2;
  return [list.slice(0, first), list.slice(first)];
}

const byBpm = (list) => parts(list, layout.bpm_counts);
const byCorrector = (list) => parts(list, layout.corrector_counts);

function build() {
  at("charts").replaceChildren();
  at("figures").replaceChildren();
  const planes = [...layout.planes];
  charts = { planes: [], trend: null };
  for (const plane of planes) at("figures").append(tile(`rms-${plane}`, `Orbit RMS ${plane}`));
  at("figures").append(tile("worst", "Largest error"), tile("bpms", "BPMs in use"),
    tile("nearest", "Corrector closest to limit"), tile("current", "Beam current"), tile("pace", "Loop"));
  const bpms = [byBpm(layout.bpm_s), byBpm(layout.bpms), { unit: "µm" }];
  const correctors = [byCorrector(layout.corrector_s), byCorrector(layout.correctors), { unit: "A", limit: layout.limit }];
  const along = (id, title, [s, names, options]) => planes.map((hue, index) => new RingChart(
    ...chart(`${id}-${hue}`, `${title} ${hue} [${options.unit}]`),
    { ring: layout.circumference, s: s[index], names: names[index], hue, ...options }));
  const errors = along("error", "Orbit error", bpms);
  const orbits = along("orbit", "Orbit", [...bpms.slice(0, 2), { unit: "µm", line: true }]);
  const setpoints = along("setpoints", "Setpoints", correctors);
  charts.planes = planes.map((_, index) => ({ error: errors[index], orbit: orbits[index], setpoints: setpoints[index] }));
  const title = `Orbit RMS ${planes.join(" and ")} [µm] in time`;
  charts.trend = new TrendChart(...chart("trend", title), planes);
  at("charts").classList.toggle("pairs", planes.length > 1);
}

function figures(its) {
  for (const plane of layout.planes) {
    say(`rms-${plane}`, quantity(its.rms_um[plane], "µm"));
    const floor = its.floor_um === null ? "" : `, noise ${quantity(its.floor_um, "µm")}`;
    say(`rms-${plane}-more`, `10 s ${quantity(its.rms_10s_um[plane], "µm")}${floor}`);
  }
  say("worst", quantity(its.worst_um, "µm"));
  say("worst-more", its.worst_bpm);
  const bad = [...its.bpms].filter((flag) => flag === "1").length;
  const out = [...its.bpms].filter((flag) => flag === "2").length;
  say("bpms", `${its.bpms.length - bad - out} of ${layout.bpms.length}`);
  say("bpms-more", [bad ? `${bad} bad` : "none bad", out ? `${out} left out` : ""].filter(Boolean).join(", "));
  at("bpms").parentElement.classList.toggle("warn", bad > 0);
  const { name, setpoint_A: setpoint, limit_A: limit } = its.nearest;
  const share = setpoint === null ? null : Math.abs(setpoint) / limit;
  say("nearest", share === null ? UNKNOWN : `${Math.round(100 * share)} %`);
  say("nearest-more", name ? `${name} ${signed(setpoint, "A")} of ${quantity(limit, "A")}` : "");
  at("nearest").parentElement.classList.toggle("warn", share !== null && share > 0.9);
  say("current", quantity(its.current_mA, "mA"));
  say("pace", its.period_ms ? quantity(1e3 / its.period_ms, "Hz") : UNKNOWN);
  say("pace-more", `latency p99 ${quantity(its.latency99_ms, "ms")}`);
}

function along(its) {
  const old = orbitOld(its, layout);
  document.body.classList.toggle("no-orbit", old);
  const none = its.orbit_age === undefined ? "no orbit yet"
    : `no orbit since ${timeOfDay(its.time - its.orbit_age)}: these are the last values`;
  const [errors, orbits, flags] = [byBpm(its.error_um), byBpm(its.orbit_um), byBpm(its.bpms)];
  const [setpoints, moving] = [byCorrector(its.setpoints_A), byCorrector(its.movable ?? "")];
  charts.planes.forEach(({ error, orbit, setpoints: set }, index) => {
    const plane = layout.planes[index];
    const still = [...moving[index]].map((free) => (free === "1" ? "0" : "2")).join("");
    error.set(errors[index], flags[index], its.floor_um);
    orbit.set(orbits[index], flags[index], null);
    set.set(setpoints[index], still, null);
    const those = (names, marks, mark) => names.filter((_, number) => marks[number] === mark);
    const bad = those(error.names, flags[index], "1"), out = those(error.names, flags[index], "2");
    say(`error-${plane}-note`, [
      old ? none : "",
      bad.length ? `✕ bad: ${some(bad)}` : "",
      out.length ? `○ left out: ${some(out)}` : "",
    ].filter(Boolean).join("; "));
    at(`error-${plane}-note`).classList.toggle("bad", old);
    const fixed = those(set.names, still, "2");
    say(`setpoints-${plane}-note`, [
      `limit ±${quantity(layout.limit, "A")}`, fixed.length ? `○ do not move: ${some(fixed)}` : "",
    ].filter(Boolean).join("; "));
  });
  if (Math.abs(its.time - told) > TOLD) describe(its.time);
}

// In words, for those who hear the page; not at every picture, or they would hear nothing else.
function describe(now) {
  told = now;
  for (const canvas of document.querySelectorAll("canvas")) {
    const title = canvas.parentElement.querySelector("h2").textContent;
    const words = [title, at(`${canvas.id}-readout`).textContent, at(`${canvas.id}-note`).textContent];
    canvas.setAttribute("aria-label", words.filter(Boolean).join("; "));
  }
}

function gap(its) {
  say("gap", its.gap.headline);
  at("gap").classList.toggle("resolved", its.gap.resolved);
  say("gap-time", its.gap.time === null ? "" : `checked at ${moment(its.gap.time, its.time)}`);
  const report = its.report, key = JSON.stringify(report), place = at("report");
  if (place.dataset.key === key) return;
  place.dataset.key = key;
  if (!report) {
    place.textContent = "No diagnosis report in the data directory yet.";
    return;
  }
  const href = `reports/${encodeURIComponent(report.name)}`;
  const link = make("a", { href, target: "_blank", rel: "noopener", textContent: "Last diagnosis report" });
  const words = report.headline ? `: ${report.headline}` : "";
  place.replaceChildren(link, `, ${moment(report.time, its.time)}${words}`);
}

function policy(its) {
  const { refits, last_refit: last } = its;
  say("policy", its.policy || UNKNOWN);
  const swaps = `${its.swaps} swap${its.swaps === 1 ? "" : "s"} since the start`;
  say("policy-since", `${moment(its.policy_since, its.time)}, ${swaps}`);
  say("refits", `${refits.promoted} promoted, ${refits.refused} refused, ${refits.rolled_back} rolled back`);
  say("last-refit", last
    ? `${moment(last.time, its.time)} ${last.decision.replace("_", " ")}: ${last.reason}` : "none yet");
  const alarms = Object.entries(its.alarms).filter(([, number]) => number > 0);
  say("alarms", alarms.map(([cause, number]) => `${number} × ${cause}`).join(", ") || "none");
}

function loop(its) {
  say("ticks", count(its.ticks));
  say("missed", count(its.missed));
  say("period", `${quantity(its.period_ms, "ms")}, jitter ${quantity(its.jitter_ms, "ms")}`);
  const rf = its.rf;
  const energy = rf.energy_ppm === null ? "" : `, energy of the correctors ${rf.energy_ppm.toFixed(1)} ppm`;
  const [ratio, low, high] = (rf.found || []).map((value) => value.toFixed(3));
  const found = rf.found ? `, column found ${ratio} [${low}, ${high}] of the one told` : "";
  say("rf", (rf.follows ? `follows, ${rf.steps} steps${energy}` : `not adjusted: ${rf.reason}`) + found);
  handOver(its.hand_over);
  say("latency", `p50 ${quantity(its.latency50_ms, "ms")}, p99 ${quantity(its.latency99_ms, "ms")}`);
  say("service", `orbitfb ${its.version}, since ${moment(its.started, its.time)}`);
}

function handOver(its) {
  at("hand-over-title").hidden = at("hand-over").hidden = !its;
  if (!its) return;
  const left = its.left_um === null ? "" : `, ${quantity(its.left_um, "µm")} left`;
  const why = its.reason ? `: ${its.reason}` : "";
  say("hand-over", `reference ${its.state === "HANDS OVER" ? `handed over${left}` : `not handed over, ${its.state}`}${why}`);
}

// The page shows the command and does not give it: whoever reads the page is not known to it.
function measurement(its) {
  const { state, running, done, total, share, left_s: left, text } = its.measurement;
  const part = `${done} of ${total} correctors, ${duration(left)} left`;
  say("measure", running ? `${state.toLowerCase()}: ${part}` : state === "IDLE" ? "none since the start" : state.toLowerCase());
  at("measure-share").hidden = !running;
  at("measure-share").value = share;
  say("measure-text", text);
  const may = running || its.state === "OPEN";
  say("measure-what", running ? "Abort, and put the setpoints back:" : may ? "Start:" : "Open the loop first.");
  say("measure-how", may ? `orbitfb command measure action=${running ? "abort" : "start"}` : "");
}

function happened(its) {
  const place = at("happenings"), key = JSON.stringify(its.happenings);
  if (place.dataset.key === key) return;
  place.dataset.key = key;
  place.replaceChildren(...its.happenings.toReversed().map((line) => make("li", {},
    make("time", { textContent: moment(line.time, its.time) }),
    make("b", { textContent: line.kind }), make("span", { textContent: line.text }))));
}

const link = new Link(greet, take, () => setTimeout(() => look()));
setInterval(() => look(), LOOK);
document.addEventListener("visibilitychange", () => look());
window.addEventListener("pageshow", (event) => { if (event.persisted) location.reload(); });
