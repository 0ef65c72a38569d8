// The alert, large enough for arm's length, in words for those who listen; never by colour alone.

import { LEVELS, bearing, side } from "./message.js";

const $ = (id) => document.getElementById(id);

export class Banner {
  constructor() {
    this.said = "";
  }

  // The alert of a picture; doubted: whether something keeps it from being trusted.
  alert(picture, doubted) {
    const level = doubted && !picture.level ? "doubt" : LEVELS[picture.level], track = picture.level ? picture.rows.find((t) => t.id === picture.track) : null;
    $("banner").dataset.level = level;
    $("level").textContent = picture.level ? level : doubted ? "unsure" : "no alert";
    const seconds = picture.level && picture.ttc !== null ? picture.ttc.toFixed(1) : "";
    $("ttc").hidden = !seconds;
    $("seconds").textContent = seconds;
    const angle = track ? bearing(picture, track) : 0;
    $("bearing").toggleAttribute("hidden", !track);
    if (track) $("bearing").style.transform = `rotate(${(-angle).toFixed(3)}rad)`;
    const moving = picture.rows.filter((t) => t.state === 1 || t.state === 2).length;
    const others = doubted ? "no alert, but it cannot be trusted" : moving ? `${moving} moving` : "nothing moves";
    $("where").textContent = track ? side(angle) : picture.level ? "not seen now" : others;
    $("which").textContent = picture.level ? `track ${picture.track}` : "";
    const who = track ? ` ${side(angle)}, track ${track.id}` : "";
    const when = seconds ? `, contact in ${seconds} seconds` : "";
    this.say(`${level} ${picture.track}`, picture.level ? `${level}:${who}${when}` : doubted ? others : "no alert");
  }

  // Nothing can be said about now.
  dead(title, reason) {
    $("banner").dataset.level = "dead";
    $("level").textContent = title;
    $("ttc").hidden = true;
    $("bearing").toggleAttribute("hidden", true);
    $("where").textContent = reason;
    $("which").textContent = "";
    this.say(`dead ${title}`, `${title}. There are no warnings.`);
  }

  // Why it cannot be trusted, in words; empty when it can.
  trust(reasons) {
    const text = reasons.join("; ");
    if ($("reasons").textContent === text) return;
    $("trust").hidden = !text;
    $("reasons").textContent = text;
    const kind = text.replace(/[\d.]+/g, ""); // numbers that run are not read out again and again
    if (kind !== this.kind) $("aside").textContent = text ? `Cannot be trusted: ${text}` : "";
    this.kind = kind;
  }

  // Aloud, once for each change.
  say(key, words) {
    if (key === this.said) return;
    const first = !this.said && words === "no alert";
    this.said = key;
    if (!first) $("spoken").textContent = words;
  }
}
