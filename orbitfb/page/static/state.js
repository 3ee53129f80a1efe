// The bar on top: the state of the loop, or that this is not live.

import { ago, duration, moment, quantity, timeOfDay } from "./words.js";

const RESTART_TOLD = 60; // seconds
const MEANINGS = {
  STARTING: "no tick yet",
  OPEN: "reads and records, writes nothing",
  SHADOW: "decides, writes nothing",
  CLOSED: "corrects the orbit",
  HELD: "writes nothing, closes again by itself",
  TRIPPED: "writes nothing until an operator resets it",
  FAULT: "the program failed; read the log",
};

const MEASURING = "writes only to measure the response";

export const at = (id) => document.getElementById(id);

export function say(id, text) {
  const element = at(id);
  if (element.textContent !== text) element.textContent = text;
}

// Whether the figures of the orbit are those of one that is no longer true.
export function orbitOld(its, layout) {
  return its.orbit_age === undefined || its.orbit_age > Math.max(1, 3 * layout.period);
}

// its: the last picture, if there was one; link: where it came from; restarted: when [s].
export function showState(its, link, restarted, layout) {
  const late = !its || !link.live;
  const state = its?.state ?? "STARTING";
  const silent = !late && !its.alive && state !== "FAULT";
  document.body.classList.toggle("stale", late || silent);
  let shown = state, more = "";
  if (late) [shown, more] = ["NOT LIVE", its ? `was ${state} at ${timeOfDay(its.time)}, ${ago(link.age)}` : ""];
  else if (silent) [shown, more] = ["NO TICKS", `was ${state}; last tick ${ago(its.tick_age)}`];
  else more = `for ${duration(its.in_state)} · ${its.measurement.running ? MEASURING : MEANINGS[state]}`;
  say("state", shown);
  say("state-for", more);
  at("bar").dataset.state = late || silent ? "" : state;
  say("reason", late ? "" : its.reason);
  say("who", late ? "" : commanded(its));
  say("live", late ? "not live" : "live");
  say("clock", its ? timeOfDay(its.time) : "");
  const known = Object.values(its?.rms_um ?? {}).filter((value) => value !== null);
  const rms = quantity(known.length ? Math.max(...known) : null, "µm"); // of the worse plane
  document.title = `${shown} ${late || silent ? "" : rms} · orbitfb`;
  notify(its, link, late, silent, restarted, layout);
}

function commanded(its) {
  const given = its.command;
  if (!given) return "no command since the start";
  const did = given.did[0].toUpperCase() + given.did.slice(1);
  return `${did} by ${given.by}, ${moment(given.time, its.time)}`;
}

function notify(its, link, late, silent, restarted, layout) {
  let words = "", calm = false;
  if (late) {
    const old = its ? `Grey values are of ${timeOfDay(its.time)}. ` : "";
    words = `NOT LIVE: ${link.problem || "no data come"}. ${old}Trying again.`;
  } else if (silent) words = "The loop does not tick: grey values are out of date.";
  else if (orbitOld(its, layout)) words = "No orbit data: grey values are out of date.";
  else if (restarted && its.time - restarted < RESTART_TOLD) {
    words = `The service was started again at ${timeOfDay(its.started)}.`;
    calm = true;
  }
  say("notice", words);
  at("notice").hidden = !words;
  at("notice").classList.toggle("calm", calm);
}
