// A link `#replay-RUN_ID` opens that run's replay page, which stands packed in this page, over it.
const dialog = document.getElementById("replay");
const frame = document.getElementById("replay-frame");

async function follow() {
  const asked = decodeURIComponent(location.hash.slice(1));
  const stored = asked.startsWith("replay-") ? document.getElementById(asked) : null;
  if (!stored || stored.type !== "text/plain") {
    if (dialog.open) dialog.close();
    return;
  }
  document.getElementById("replay-title").textContent = asked.replace("replay-", "Replay of ");
  const page = await unpacked(stored.textContent).text();
  frame.addEventListener("load", () => frame.contentWindow.focus(), { once: true });
  frame.srcdoc = page;
  if (!dialog.open) dialog.showModal();
}

dialog.addEventListener("close", () => {
  // Nothing may go on playing behind the report.
  frame.srcdoc = "";
  if (location.hash.startsWith("#replay-")) location.hash = "#worst";
});
document.getElementById("replay-close").addEventListener("click", () => dialog.close());
// Keys go to the replay; it passes on the one that closes it.
frame.addEventListener("leave", () => dialog.close());
window.addEventListener("hashchange", follow);
follow();
