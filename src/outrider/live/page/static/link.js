// The connection: asks for the token where one is wanted, takes pictures, tells how fresh they are.

const RETRY_MS = 1000;
const FULL = 1013, GONE = 1001; // close codes of the server

export class Link {
  // hello(text), picture(buffer), beat(object), changed() are called as things come.
  constructor(listeners, ask) {
    Object.assign(this, listeners);
    this.ask = ask; // shows the form for a token, with why the last one was refused
    this.state = "connecting"; // open, lost, full, ended, token
    this.reason = "";
    this.heard = performance.now(); // when anything came last [ms]
    this.retry = 0;
    this.enter();
  }

  async enter() {
    clearTimeout(this.retry);
    const token = decodeURIComponent(location.hash.slice(1));
    try {
      let { admitted } = await (await fetch("session")).json();
      if (!admitted && token) admitted = await this.show(token);
      if (admitted) {
        if (token) history.replaceState(null, "", location.pathname); // not for the next one who looks
        this.open();
      } else {
        this.set("token");
        this.ask(token ? "That token is not the right one." : "");
      }
    } catch {
      this.set("lost");
      this.again();
    }
  }

  async show(token) {
    return (await fetch("enter", { method: "POST", body: token })).ok;
  }

  again() {
    clearTimeout(this.retry);
    this.retry = setTimeout(() => this.enter(), RETRY_MS);
  }

  open() {
    const place = location.origin.replace(/^http/, "ws") + "/pictures";
    const socket = this.socket = new WebSocket(place);
    socket.binaryType = "arraybuffer";
    let greeted = false;
    socket.onmessage = ({ data }) => {
      this.heard = performance.now();
      if (typeof data !== "string") {
        this.picture(data);
        if (this.takes) socket.send("taken");
      } else if (greeted) {
        this.beat(JSON.parse(data));
      } else {
        greeted = true;
        const hello = JSON.parse(data);
        this.takes = hello.mode === "live";
        this.hello(hello);
        this.set("open");
      }
    };
    socket.onclose = ({ code, reason }) => {
      if (socket !== this.socket) return;
      this.reason = reason;
      this.set(code === FULL ? "full" : code === GONE ? "ended" : "lost");
      this.again();
    };
  }

  want(index) {
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(String(index));
  }

  get silence() { // seconds since anything came
    return (performance.now() - this.heard) / 1000;
  }

  set(state) {
    if (state === "open" || this.state !== "ended" || state !== "lost") this.state = state; // an end stays one
    this.changed();
  }
}
