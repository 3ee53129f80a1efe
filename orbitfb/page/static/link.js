// The connection to the service: comes again by itself, and knows whether what it brought is live.

const LATE = 1500; // a picture older than so many milliseconds is not live
const RETRY_FIRST = 500, RETRY_MOST = 3000, CONNECT_MOST = 5000;
const TOO_MANY = 4013;

export class Link {
  // greet: gets what is sent first. show: gets every picture. changed: told when it may not be live.
  constructor(greet, show, changed) {
    Object.assign(this, { greet, show, changed });
    Object.assign(this, { problem: "connecting", when: -Infinity, wall: 0, retry: RETRY_FIRST });
    this.connect();
  }

  get live() {
    // two clocks: one of them stands still while a phone sleeps
    return Math.max(performance.now() - this.when, Date.now() - this.wall) < LATE;
  }

  // Seconds since the last picture.
  get age() { return (Date.now() - this.wall) / 1e3; }

  connect() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}/live`);
    const patience = setTimeout(() => socket.close(), CONNECT_MOST);
    socket.onopen = () => clearTimeout(patience);
    socket.onmessage = (event) => this.take(JSON.parse(event.data));
    socket.onclose = (event) => {
      clearTimeout(patience);
      const full = event.code === TOO_MANY;
      this.lose(full ? "too many pages are open elsewhere" : "the service does not answer");
      setTimeout(() => this.connect(), this.retry * (0.8 + 0.4 * Math.random()));
      this.retry = Math.min(RETRY_MOST, 1.5 * this.retry);
    };
  }

  take(message) {
    if (message.kind === "hello") this.greet(message);
    else if (message.kind === "problem") this.lose(message.problem);
    else {
      Object.assign(this, { problem: "", retry: RETRY_FIRST, when: performance.now(), wall: Date.now() });
      this.show(message);
    }
  }

  lose(problem) {
    this.problem = problem;
    this.when = -Infinity;
    this.changed();
  }
}
