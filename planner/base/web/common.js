"use strict";
// What all pages of this program have in common. What a page shows stands in one value that the server sends whole,
// whenever something changed.
const page = (function () {
  const by = (id) => document.getElementById(id);

  function element(name, attributes, ...children) {
    const made = document.createElement(name);
    for (const [key, value] of Object.entries(attributes || {})) {
      if (key in made) made[key] = value; else made.setAttribute(key, value);
    }
    made.append(...children);
    return made;
  }

  function note(text, lost) {
    by("note").textContent = text;
    by("note").className = lost ? "lost" : "";
  }

  // draw: gets each value; lost: is called where the server cannot be reached
  function listen(draw, lost) {
    const news = new EventSource("events");
    news.addEventListener("message", (event) => {
      draw(JSON.parse(event.data));
      document.documentElement.dataset.turn = String(Number(document.documentElement.dataset.turn || 0) + 1);
    });
    news.addEventListener("error", lost);
  }

  function ask(order, lost) {
    return fetch("do", { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(order) })
      .catch(lost);
  }

  return { by, element, note, listen, ask };
})();
