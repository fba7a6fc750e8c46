const form = document.getElementById("filters"), shown = document.getElementById("shown");
const rows = [...document.querySelectorAll("#inspections tbody tr")];
const texts = rows.map(row => row.textContent.toLowerCase());
function apply() {
  const wanted = new FormData(form), words = wanted.get("text").toLowerCase().split(/\s+/).filter(Boolean);
  const [verdict, recipe, from, to] = ["verdict", "recipe", "from", "to"].map(name => wanted.get(name));
  let count = 0;
  rows.forEach((row, k) => {
    const { verdict: its, recipe: made, day } = row.dataset;
    const fits = (!verdict || its === verdict) && (!recipe || made === recipe) && (!from || day >= from) &&
      (!to || day <= to) && words.every(word => texts[k].includes(word));
    row.hidden = !fits;
    count += fits;
  });
  shown.textContent = shown.dataset.text.replace("{shown}", count).replace("{total}", rows.length);
}
form.hidden = false;
form.addEventListener("input", apply);
form.addEventListener("reset", () => setTimeout(apply));
form.addEventListener("submit", event => event.preventDefault());
apply();
