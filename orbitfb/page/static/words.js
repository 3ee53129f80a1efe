// Figures in the words and units of the control room, as the terminal writes them.

export const UNKNOWN = "—";

const known = (value) => typeof value === "number" && Number.isFinite(value);

export function threeDigits(value) {
  const size = Math.abs(value);
  if (size >= 99.95) return value.toFixed(0);
  if (size >= 9.995) return value.toFixed(1);
  return size >= 0.9995 ? value.toFixed(2) : value.toFixed(3);
}

export function quantity(value, unit) {
  return known(value) ? `${threeDigits(value)} ${unit}` : UNKNOWN;
}

export function count(value) {
  return known(value) ? String(value).replace(/\B(?=(\d{3})+$)/g, "\u202f") : UNKNOWN;
}

export function signed(value, unit) {
  if (!known(value)) return UNKNOWN;
  return `${value < 0 ? "−" : "+"}${threeDigits(Math.abs(value))} ${unit}`;
}

const two = (number) => String(number).padStart(2, "0");

export function timeOfDay(wall) {
  if (!known(wall)) return UNKNOWN;
  const at = new Date(1e3 * wall);
  return `${two(at.getHours())}:${two(at.getMinutes())}:${two(at.getSeconds())}`;
}

// With its date when that is not the date of `now`, both in seconds since the epoch.
export function moment(wall, now) {
  if (!known(wall)) return UNKNOWN;
  const at = new Date(1e3 * wall);
  const same = at.toDateString() === new Date(1e3 * now).toDateString();
  const day = `${at.getFullYear()}-${two(at.getMonth() + 1)}-${two(at.getDate())}`;
  return same ? timeOfDay(wall) : `${day} ${timeOfDay(wall)}`;
}

export function duration(seconds) {
  if (!known(seconds)) return UNKNOWN;
  const whole = Math.max(0, Math.floor(seconds));
  const days = Math.floor(whole / 86400);
  const clock = `${Math.floor((whole % 86400) / 3600)}:${two(Math.floor((whole % 3600) / 60))}:${two(whole % 60)}`;
  return days ? `${days} d ${clock}` : clock;
}

export function ago(seconds) {
  if (!known(seconds)) return UNKNOWN;
  if (seconds < 60) return `${Math.max(0, Math.round(seconds))} s ago`;
  return `${duration(seconds)} ago`;
}

export function some(names, most = 4) {
  const more = names.length - most;
  return more > 0 ? `${names.slice(0, most).join(", ")} and ${more} more` : names.join(", ");
}
