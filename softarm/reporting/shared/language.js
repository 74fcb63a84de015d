// A browser without a locale (LANG=C) reports a language that Intl rejects, and uPlot creates a formatter while loading.
try {
  new Intl.NumberFormat(navigator.language);
} catch {
  Object.defineProperty(navigator, "language", { value: "en" });
}
