// Theme and charts, for every page. Colours live in the style sheet alone; charts ask for them.
"use strict";

const nimprep = {
  // What a page's data blocks hold, by id; null where there is none.
  data(id) {
    const block = document.getElementById(id);
    return block ? JSON.parse(block.textContent) : null;
  },
  // A new element: properties as DOM has them, "aria-*" and "data-*" as attributes. Text stays text.
  element(name, properties = {}, ...children) {
    const made = document.createElement(name);
    for (const [key, value] of Object.entries(properties)) {
      if (key.includes("-")) made.setAttribute(key, value);
      else made[key] = value;
    }
    made.append(...children);
    return made;
  },
  pick: {}, // Per chart: called with the number of the frame whose point was clicked.
};

(() => {
  const root = document.documentElement;
  const button = document.getElementById("theme");
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const store = {
    get: () => { try { return localStorage.getItem("nimprep-theme"); } catch { return null; } },
    set: (value) => { try { localStorage.setItem("nimprep-theme", value); } catch { /* private */ } },
  };
  const current = () => root.dataset.theme || (dark.matches ? "dark" : "light");

  const resolve = (value, style) => {
    if (typeof value === "string") {
      const name = /^var\((--[\w-]+)\)$/.exec(value);
      return name ? style.getPropertyValue(name[1]).trim() : value;
    }
    if (Array.isArray(value)) return value.map((v) => resolve(v, style));
    if (value && typeof value === "object")
      return Object.fromEntries(Object.entries(value).map(([k, v]) => [k, resolve(v, style)]));
    return value;
  };

  const themed = (figure) => {
    const style = getComputedStyle(root);
    const { data, layout } = resolve(figure, style);
    const text = style.getPropertyValue("--muted").trim();
    const line = style.getPropertyValue("--line").trim();
    const surface = style.getPropertyValue("--surface").trim();
    const axis = (own) => ({
      gridcolor: line, linecolor: line, zerolinecolor: line, tickcolor: line, automargin: true, ...own,
    });
    return {
      data,
      layout: {
        ...layout,
        font: { family: "system-ui, sans-serif", size: 12, color: text },
        paper_bgcolor: "rgba(0,0,0,0)",
        plot_bgcolor: "rgba(0,0,0,0)",
        hoverlabel: { bgcolor: surface, bordercolor: line, font: { color: style.getPropertyValue("--text").trim() } },
        xaxis: axis(layout.xaxis),
        yaxis: axis(layout.yaxis),
      },
    };
  };

  const figures = nimprep.data("figures") || {};
  const drawn = new Set();
  const draw = (id) => {
    const place = document.getElementById(id);
    const { data, layout } = themed(figures[id]);
    const settings = { displayModeBar: false, responsive: true, scrollZoom: false };
    Plotly.react(place, data, layout, settings);
    if (!drawn.has(id)) {
      place.on("plotly_click", (event) => {
        const frame = event.points[0].customdata;
        if (nimprep.pick[id] && frame !== undefined) nimprep.pick[id](Number(frame));
      });
    }
    drawn.add(id);
  };
  const seen = new IntersectionObserver((entries) => {
    for (const entry of entries) {
      if (!entry.isIntersecting) continue;
      seen.unobserve(entry.target);
      draw(entry.target.id);
    }
  }, { rootMargin: "300px" });
  for (const id of Object.keys(figures)) {
    const place = document.getElementById(id);
    if (place) seen.observe(place);
  }

  const show = () => {
    button.textContent = current() === "dark" ? "Light" : "Dark";
    button.setAttribute("aria-label", `Switch to ${button.textContent.toLowerCase()} colours`);
    for (const id of drawn) draw(id);
  };
  const remembered = store.get();
  if (remembered === "dark" || remembered === "light") root.dataset.theme = remembered;
  button.hidden = false;
  button.addEventListener("click", () => {
    root.dataset.theme = current() === "dark" ? "light" : "dark";
    store.set(root.dataset.theme);
    show();
  });
  dark.addEventListener("change", show);
  show();
})();
