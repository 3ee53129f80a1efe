// Charts on canvas: values along the ring, and their course in time.

import { quantity, signed, UNKNOWN } from "./words.js";

export const TREND_SPAN = 900; // seconds
const SPANS = [60, 300, TREND_SPAN];
const LEFT = 46, RIGHT = 8, TOP = 8, BOTTOM = 20;
const SHRINK_AFTER = 4000; // a scale grows at once and shrinks only after so many milliseconds
const LIMIT_SHOWN = 0.25; // part of a limit from which on the limit itself is in the picture
const LABEL_ROOM = 12; // pixels
const STEPS = [1, 2, 5, 10];

const known = (value) => value !== null && Number.isFinite(value);

function niceAbove(value) {
  const decade = 10 ** Math.floor(Math.log10(value));
  return decade * STEPS.find((step) => step * decade >= value * 0.9999);
}

function colours() {
  const style = getComputedStyle(document.documentElement);
  return (name) => style.getPropertyValue(`--${name}`).trim();
}

class Chart {
  constructor(canvas) {
    this.canvas = canvas;
    new ResizeObserver(() => this.draw()).observe(canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
  }

  begin() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const ratio = window.devicePixelRatio || 1;
    if (this.canvas.width !== Math.round(width * ratio) || this.canvas.height !== Math.round(height * ratio)) {
      this.canvas.width = Math.round(width * ratio);
      this.canvas.height = Math.round(height * ratio);
    }
    const context = this.canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    context.font = "11px system-ui, sans-serif";
    Object.assign(this, { width, height, context, colour: colours() });
    return width > LEFT + RIGHT && height > TOP + BOTTOM;
  }

  horizontal(y, name, dash = []) {
    const { context } = this;
    context.strokeStyle = this.colour(name);
    context.lineWidth = 1;
    context.setLineDash(dash);
    context.beginPath();
    context.moveTo(LEFT, Math.round(y) + 0.5);
    context.lineTo(this.width - RIGHT, Math.round(y) + 0.5);
    context.stroke();
    context.setLineDash([]);
  }

  label(text, x, y, align, base) {
    this.context.fillStyle = this.colour("quiet");
    this.context.textAlign = align;
    this.context.textBaseline = base;
    this.context.fillText(text, x, y);
  }
}

// Values at places along the ring, on a scale that is symmetric around zero.
export class RingChart extends Chart {
  // options: unit, s [m], names, ring (its length [m]), hue, line (instead of bars), limit
  constructor(canvas, readout, options) {
    super(canvas);
    Object.assign(this, options, { readout, values: [], flags: "", floor: null, half: 0, since: 0 });
    canvas.addEventListener("pointermove", (event) => this.point(event));
    canvas.addEventListener("pointerdown", (event) => this.point(event));
    canvas.addEventListener("pointerleave", (event) => {
      if (event.pointerType !== "touch") this.choose(null); // a finger leaves at once: it stays
    });
    this.at = null;
  }

  set(values, flags, floor) {
    Object.assign(this, { values, flags, floor });
    this.scale();
    this.say();
    this.draw();
  }

  scale() {
    let largest = known(this.floor) ? 2 * this.floor : 0;
    for (const value of this.values) if (known(value)) largest = Math.max(largest, Math.abs(value));
    const whole = this.limit && largest > LIMIT_SHOWN * this.limit;
    const wanted = whole ? Math.max(1.08 * this.limit, largest) : niceAbove(Math.max(largest, 0.1));
    const now = performance.now();
    if (wanted >= this.half) { this.half = wanted; this.since = now; }
    else if (wanted > 0.55 * this.half) this.since = now;
    else if (now - this.since > SHRINK_AFTER) { this.half = wanted; this.since = now; }
  }

  x(s) { return LEFT + (s / this.ring) * (this.width - LEFT - RIGHT); }
  y(value) { return TOP + (0.5 - value / (2 * this.half)) * (this.height - TOP - BOTTOM); }

  point(event) {
    const s = ((event.offsetX - LEFT) / (this.width - LEFT - RIGHT)) * this.ring;
    let best = 0;
    this.s.forEach((place, index) => { if (Math.abs(place - s) < Math.abs(this.s[best] - s)) best = index; });
    const again = event.type === "pointerdown" && event.pointerType === "touch" && best === this.at;
    this.choose(again ? null : best);
  }

  choose(at) {
    this.at = at;
    this.say();
    this.draw();
  }

  // What is under the pointer, or the largest value.
  say() {
    let at = this.at;
    if (at === null) {
      this.values.forEach((value, index) => {
        if (known(value) && (at === null || Math.abs(value) > Math.abs(this.values[at]))) at = index;
      });
    }
    if (at === null || at >= this.values.length) { this.readout.textContent = ""; return; }
    const word = this.at === null ? "largest " : "";
    const value = known(this.values[at]) ? signed(this.values[at], this.unit) : "not valid";
    const left = this.flags[at] === "2" ? ", left out" : "";
    this.readout.textContent = `${word}${value}${left} at ${this.names[at]}`;
  }

  draw() {
    if (!this.half || !this.begin()) return;
    const { context } = this;
    const limited = this.limit && this.half > this.limit;
    const size = limited ? this.limit : this.half;
    for (const part of [-1, -0.5, 0, 0.5, 1]) {
      const y = this.y(part * size);
      const edge = limited && Math.abs(part) === 1;
      this.horizontal(y, edge ? "limit" : part ? "grid" : "axis", edge ? [6, 4] : []);
      const text = part ? `${part < 0 ? "−" : ""}${+(Math.abs(part) * size).toPrecision(3)}` : "0";
      this.label(text, LEFT - 6, y, "right", "middle");
    }
    const step = niceAbove(this.ring / (this.width > 480 ? 8 : 4));
    for (let s = 0; s <= this.ring; s += step) {
      const last = s + step > this.ring;
      this.label(last ? `${s} m` : s, this.x(s), this.height - BOTTOM + 5, "center", "top");
    }
    if (known(this.floor) && !this.line) {
      context.fillStyle = this.colour("floor-band");
      const top = this.y(this.floor);
      context.fillRect(LEFT, top, this.width - LEFT - RIGHT, this.y(-this.floor) - top);
    }
    this.marks();
    if (this.line) this.course(); else this.bars();
  }

  bars() {
    const { context } = this;
    const wide = Math.max(1, Math.min(6, (0.6 * (this.width - LEFT - RIGHT)) / this.values.length));
    const zero = this.y(0);
    this.values.forEach((value, index) => {
      if (!known(value)) return;
      const bounded = Math.max(-this.half, Math.min(this.half, value));
      const near = this.limit && Math.abs(value) > 0.9 * this.limit;
      const out = this.flags[index] === "2";
      context.fillStyle = this.colour(index === this.at ? "text" : near ? "bad" : out ? "quiet" : this.hue);
      const y = this.y(bounded);
      context.fillRect(this.x(this.s[index]) - wide / 2, Math.min(y, zero), wide, Math.max(1, Math.abs(y - zero)));
    });
  }

  course() {
    const { context } = this;
    context.strokeStyle = this.colour(this.hue);
    context.lineWidth = 1.5;
    context.lineJoin = "round";
    context.beginPath();
    let pen = false;
    this.values.forEach((value, index) => {
      if (!known(value) || this.flags[index] === "2") { pen = false; return; }
      const x = this.x(this.s[index]), y = this.y(value);
      if (pen) context.lineTo(x, y); else context.moveTo(x, y);
      pen = true;
    });
    context.stroke();
    if (this.at !== null && known(this.values[this.at])) {
      context.fillStyle = this.colour("text");
      context.beginPath();
      context.arc(this.x(this.s[this.at]), this.y(this.values[this.at]), 3, 0, 7);
      context.fill();
    }
  }

  // A cross where the reading is bad, a ring where somebody left the device out.
  marks() {
    const { context } = this;
    [...this.flags].forEach((flag, index) => {
      if (flag === "0") return;
      const x = this.x(this.s[index]), y = this.height - BOTTOM - 8;
      context.strokeStyle = this.colour(flag === "1" ? "bad" : "quiet");
      context.globalAlpha = 0.35;
      context.lineWidth = 1;
      context.beginPath();
      context.moveTo(x, TOP);
      context.lineTo(x, this.height - BOTTOM);
      context.stroke();
      context.globalAlpha = 1;
      context.lineWidth = 2;
      context.beginPath();
      if (flag === "1") {
        context.moveTo(x - 4, y - 4); context.lineTo(x + 4, y + 4);
        context.moveTo(x - 4, y + 4); context.lineTo(x + 4, y - 4);
      } else context.arc(x, y, 4, 0, 7);
      context.stroke();
    });
  }
}

// RMS in time on a logarithmic scale, the noise floor dashed. A point: [time, floor, value…].
export class TrendChart extends Chart {
  constructor(canvas, readout, hues) {
    super(canvas);
    Object.assign(this, { readout, hues, points: [], now: 0, floor: document.createElement("span") });
    const keys = hues.map((hue) => {
      const key = document.createElement("span");
      return Object.assign(key, { className: `key key-${hue}`, textContent: `${hue} ` });
    });
    readout.replaceChildren(...(hues.length > 1 ? keys : []), this.floor);
  }

  set(points, now, believed) {
    Object.assign(this, { points, now });
    const floor = points.at(-1)?.[1];
    const origin = believed ? " as configured" : "";
    this.floor.textContent = known(floor) ? `noise floor ${quantity(floor, "µm")}${origin}, dashed` : "";
    this.draw();
  }

  draw() {
    if (!this.points.length || !this.begin()) return;
    const age = this.now - this.points[0][0];
    const span = SPANS.find((seconds) => seconds >= age) ?? SPANS.at(-1);
    const from = this.now - span;
    const shown = this.points.filter((point) => point[0] >= from);
    const values = shown.flatMap((point) => point.slice(1)).filter((value) => known(value) && value > 0);
    if (!values.length) { this.label(UNKNOWN, this.width / 2, this.height / 2, "center", "middle"); return; }
    const low = Math.floor(Math.log10(Math.min(...values)) - 0.05);
    const high = Math.max(low + 1, Math.ceil(Math.log10(Math.max(...values)) + 0.05));
    const y = (value) => TOP + ((high - Math.log10(value)) / (high - low)) * (this.height - TOP - BOTTOM);
    const x = (time) => LEFT + ((time - from) / span) * (this.width - LEFT - RIGHT);
    const room = y(1) - y(2) > LABEL_ROOM;
    for (let decade = low; decade <= high; decade += 1) {
      for (const part of room && decade < high ? [1, 2, 5] : [1]) {
        const value = part * 10 ** decade;
        this.horizontal(y(value), "grid");
        this.label(value.toFixed(Math.max(0, -decade)), LEFT - 6, y(value), "right", "middle");
      }
    }
    const step = span / (this.width > 480 ? 5 : 2);
    for (let back = 0; back <= span; back += step) {
      const align = back === 0 ? "right" : back < span ? "center" : "left";
      const text = back ? (span > 60 ? `−${+(back / 60).toFixed(1)} min` : `−${back} s`) : "now";
      this.label(text, x(this.now - back), this.height - BOTTOM + 5, align, "top");
    }
    this.hues.forEach((hue, index) => this.course(shown, 2 + index, hue, [], x, y));
    this.course(shown, 1, "text", [5, 4], x, y);
  }

  course(points, column, name, dash, x, y) {
    const { context } = this;
    context.strokeStyle = this.colour(name);
    context.lineWidth = 1.5;
    context.setLineDash(dash);
    context.beginPath();
    let before = -Infinity;
    for (const point of points) {
      const value = point[column];
      if (!known(value) || value <= 0) { before = -Infinity; continue; }
      if (point[0] - before < 4) context.lineTo(x(point[0]), y(value));
      else context.moveTo(x(point[0]), y(value));
      before = point[0];
    }
    context.stroke();
    context.setLineDash([]);
  }
}
