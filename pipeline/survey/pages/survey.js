"use strict";
// The page of a study. What is due is asked of the server every time, so reloading and going back change nothing.

const page = document.getElementById("page");
const said = document.getElementById("said");
let words, study, code, step;

// A code comes from the address; else one is drawn and put there, so that a reload finds it again.
function ownCode() {
  const address = new URL(location.href);
  let given = address.searchParams.get("code");
  if (!given) {
    const bytes = crypto.getRandomValues(new Uint8Array(8));
    given = Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
    address.searchParams.set("code", given);
    history.replaceState(null, "", address);
  }
  return given;
}

function word(name, values = {}) {
  return words[name].replace(/\{(\w+)\}/g, (all, key) => (key in values ? values[key] : all));
}

function make(tag, properties = {}, ...children) {
  const element = document.createElement(tag);
  Object.assign(element, properties);
  element.append(...children.filter((child) => child !== null));
  return element;
}

function show(title, ...children) {
  const heading = make("h1", { tabIndex: -1 }, title);
  page.replaceChildren(heading, ...children);
  said.textContent = "";
  document.title = title === study.title ? title : `${title} - ${study.title}`;
  window.scrollTo(0, 0);
  heading.focus();
}

async function ask(path, sent) {
  for (let attempt = 0; ; attempt++) {
    try {
      const answer = await fetch(path, {
        method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(sent),
      });
      const value = await answer.json();
      if (answer.ok) return value;
      if (answer.status < 500) throw Object.assign(new Error(value.refused), { final: true });
      throw new Error(value.refused);
    } catch (error) {
      if (error.final || attempt === 4) throw error;
      await new Promise((done) => setTimeout(done, 300 * 2 ** attempt));
    }
  }
}

async function begin() {
  const answer = await (await fetch("words")).json();
  words = answer.words;
  study = answer.study;
  document.documentElement.lang = words.language;
  document.documentElement.dir = words.direction;
  code = ownCode();
  if (sessionStorage.getItem(`begun ${code}`)) return go(() => ask("enter", { code }));
  consent();
}

function consent() {
  const box = make("input", { type: "checkbox", id: "agree" });
  const button = make("button", { type: "submit" }, word("consent_button"));
  button.disabled = true;
  box.addEventListener("change", () => { button.disabled = !box.checked; });
  const form = make("form", {},
    make("p", {}, word("consent", { minutes: study.minutes })),
    study.contact ? make("p", {}, word("consent_contact", { contact: study.contact })) : null,
    make("label", { className: "agree", htmlFor: "agree" }, box, make("span", {}, word("consent_agree"))),
    button);
  form.addEventListener("submit", (event) => { event.preventDefault(); if (box.checked) instructions(); });
  show(word("consent_title"), form);
}

function instructions() {
  const button = make("button", { type: "button" }, word("instructions_button"));
  button.addEventListener("click", () => {
    sessionStorage.setItem(`begun ${code}`, "yes");
    go(() => ask("enter", { code }));
  });
  show(word("instructions_title"), ...study.kinds.map((kind) => make("p", {}, word(`instructions_${kind}`))), button);
}

// Asks the server for what is due and shows it; if that fails, offers to try again.
async function go(request) {
  said.textContent = word("sending");
  try {
    step = await request();
  } catch (error) {
    said.textContent = error.final ? error.message : word("failed");
    if (page.querySelector("form.trial")) return;
    const again = make("button", { type: "button" }, word("retry_button"));
    again.addEventListener("click", () => go(request));
    page.replaceChildren(again);
    return;
  }
  if (step.done) {
    show(word("done_title"), make("p", {}, word("done")), make("p", {}, word("done_code", { code })));
  } else {
    question();
  }
}

function question() {
  const shown = performance.now();
  const kind = step.grid ? "grid" : "task";
  const options = make("div", { className: "options" });
  step.options.forEach((option, index) => options.append(card(option, index + 1)));
  const heading = word(`question_${kind}`);
  const form = make("form", { className: "trial" },
    step.of > 1 ? make("p", {}, word("question_of", { number: step.number, of: step.of })) : null,
    make("fieldset", {}, make("legend", { className: "hidden" }, heading), options),
    make("button", { type: "submit" }, word("choose_button")));
  const { trial } = step;
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    const chosen = form.querySelector("input:checked");
    if (!chosen) { said.textContent = word("choose_first"); form.querySelector("input").focus(); return; }
    const seconds = Math.min((performance.now() - shown) / 1000, 86400);
    const screen = [Math.min(window.screen.width, 100000), Math.min(window.screen.height, 100000)];
    const button = form.querySelector("button[type=submit]");
    button.disabled = true;
    go(() => ask("choose", { code, trial, option: chosen.value, seconds, screen }))
      .finally(() => { button.disabled = false; });
  });
  show(heading, form);
}

function card(option, place) {
  const id = `option-${place}`;
  const input = make("input", { type: "radio", name: "option", value: option.name, id });
  const label = make("label", { htmlFor: id }, input, make("span", {}, word("option", { place })));
  const picture = option.moves ? gridPicture(step.grid, option.moves, place) : null;
  const whole = make("div", { className: "option" }, label);
  if (picture) {
    whole.append(picture);
    picture.addEventListener("click", () => input.click());
  } else {
    whole.append(...motion(option.clip, place, input));
  }
  return whole;
}

// --- paths in a grid ---

const SVG = "http://www.w3.org/2000/svg";
const STEP = { U: [0, 1], D: [0, -1], L: [-1, 0], R: [1, 0] };
const DIRECTION = { U: "up", D: "down", L: "left", R: "right" };
const CELL = 40;

function draw(parent, tag, attributes, text) {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  if (text) element.textContent = text;
  parent.append(element);
  return element;
}

function inWords(moves) {
  return (moves.match(/(.)\1*/g) || []).map((run) => word(DIRECTION[run[0]], { n: run.length })).join(", ");
}

function gridPicture(grid, moves, place) {
  const width = grid.columns * CELL, height = grid.rows * CELL;
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("viewBox", `-2 -2 ${width + 4} ${height + 4}`);
  svg.setAttribute("role", "img");
  svg.setAttribute("aria-label", word("option_path", { place, path: inWords(moves) }));
  const centre = ([column, row]) => [(column + 0.5) * CELL, height - (row + 0.5) * CELL];
  const dark = new Set(grid.obstacles.map(String));
  for (let column = 0; column < grid.columns; column++) {
    for (let row = 0; row < grid.rows; row++) {
      const fill = dark.has(String([column, row])) ? "#333" : "#fff";
      draw(svg, "rect", { x: column * CELL, y: height - (row + 1) * CELL, width: CELL, height: CELL, fill, stroke: "#8a8a8a" });
    }
  }
  let at = grid.start;
  const points = [centre(at)];
  for (const move of moves) {
    at = [at[0] + STEP[move][0], at[1] + STEP[move][1]];
    points.push(centre(at));
  }
  draw(svg, "polyline", { points: points.join(" "), fill: "none", stroke: "#0072b2", "stroke-width": 6, "stroke-linejoin": "round" });
  for (const [cell, name] of [[grid.start, "start"], [grid.goal, "goal"]]) {
    const [x, y] = centre(cell);
    draw(svg, "circle", { cx: x, cy: y, r: CELL * 0.36, fill: "#fff", stroke: "#1a1a1a", "stroke-width": 2 });
    const text = { x, y: y + 7, "text-anchor": "middle", "font-size": 20, "font-weight": 700, fill: "#1a1a1a" };
    draw(svg, "text", text, word(name));
  }
  return svg;
}

// --- motions of an arm: polygons, drawn frame by frame ---

function motion(clip, place, input) {
  const canvas = make("canvas", { width: clip.width, height: clip.height });
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", word("option", { place }));
  canvas.addEventListener("click", () => input.click());
  const button = make("button", { type: "button", className: "second" }, word("play"));
  button.setAttribute("aria-label", `${word("play")}: ${word("option", { place })}`);
  let frame = 0, running = false, before = 0;
  const context = canvas.getContext("2d");
  const polygons = (shapes) => {
    for (const [colour, points] of shapes) {
      context.beginPath();
      for (let i = 0; i < points.length; i += 2) context.lineTo(points[i], points[i + 1]);
      context.closePath();
      context.fillStyle = context.strokeStyle = clip.colours[colour];
      context.fill();
      context.stroke();
    }
  };
  const paint = () => {
    context.clearRect(0, 0, clip.width, clip.height);
    polygons(clip.still);
    context.beginPath();
    for (let i = 0; i < clip.path.length; i += 2) context.lineTo(clip.path[i], clip.path[i + 1]);
    context.strokeStyle = "#0072b2";
    context.lineWidth = 3;
    context.stroke();
    context.lineWidth = 1;
    polygons(clip.frames[Math.min(Math.floor(frame), clip.frames.length - 1)]);
  };
  const tick = (now) => {
    if (!running || !canvas.isConnected) return;
    // the first frame may have begun before the click
    frame += (Math.max(now - before, 0) / 1000) * (clip.frames.length / clip.seconds);
    before = now;
    if (frame >= clip.frames.length - 1) { frame = clip.frames.length - 1; stop(); }
    paint();
    requestAnimationFrame(tick);
  };
  const name = (text) => { button.textContent = text; button.setAttribute("aria-label", `${text}: ${word("option", { place })}`); };
  const stop = () => { running = false; name(word("play")); };
  button.addEventListener("click", () => {
    if (running) return stop();
    if (frame >= clip.frames.length - 1) frame = 0;
    running = true;
    before = performance.now();
    name(word("pause"));
    requestAnimationFrame(tick);
  });
  paint();
  if (!matchMedia("(prefers-reduced-motion: reduce)").matches) button.click();
  return [canvas, button];
}

addEventListener("pageshow", (event) => { if (event.persisted) begin(); });
begin().catch(() => { said.textContent = "This page cannot reach its server. Please load it again."; });
