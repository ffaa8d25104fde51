"""The look of the page: light and dark, from phone to desk to paper."""

CSS = """
:root{color-scheme:light dark;
--sans:system-ui,-apple-system,"Segoe UI",Roboto,"Helvetica Neue",Arial,"DejaVu Sans",sans-serif;
--mono:ui-monospace,SFMono-Regular,Menlo,Consolas,"DejaVu Sans Mono",monospace;
--page:#f4f5f7;--card:#fff;--ink:#171b22;--muted:#5c6675;--grid:#e1e4e9;--accent:#2f6fb8;--good:#17784d;--bad:#b4491a;
--good-bg:#e3f4ec;--bad-bg:#fbeadf;--flat-bg:#eceef2}
@media (prefers-color-scheme:dark){:root{--page:#101318;--card:#191d24;--ink:#e9ecf1;--muted:#9aa4b3;--grid:#2d333d;
--accent:#74aeea;--good:#63cf9f;--bad:#f0a070;--good-bg:#16342a;--bad-bg:#3c2618;--flat-bg:#252b34}}
*{box-sizing:border-box}
html{-webkit-text-size-adjust:100%}
body{margin:0;background:var(--page);color:var(--ink);font:16px/1.55 var(--sans)}
main,header,footer{max-width:1160px;margin:0 auto;padding:0 24px}
header{padding-top:44px}
.eyebrow{color:var(--muted);font-size:13px;letter-spacing:.06em;text-transform:uppercase;margin:0 0 6px}
h1{font-size:34px;line-height:1.15;letter-spacing:-.02em;margin:0 0 14px}
h2{font-size:21px;letter-spacing:-.01em;margin:44px 0 4px}
h3{font-size:16px;margin:26px 0 8px;overflow-wrap:anywhere}
.chips{display:flex;flex-wrap:wrap;gap:8px;margin:0 0 18px;padding:0;list-style:none}
.chips li{background:var(--card);border:1px solid var(--grid);border-radius:99px;padding:2px 12px;font-size:14px}
.chips span{color:var(--muted);margin-right:6px}
.lead{max-width:70ch;margin:0 0 8px;font-size:18px}
.more{max-width:74ch;margin:0 0 4px;color:var(--muted)}
.lede{max-width:74ch;margin:0 0 14px;color:var(--muted);font-size:15px}
.cards{display:grid;grid-template-columns:repeat(auto-fit,minmax(210px,1fr));gap:14px;margin:24px 0 0}
.card,figure,.scroll,details{background:var(--card);border:1px solid var(--grid);border-radius:12px}
.card{padding:16px 18px}
.card .name{color:var(--muted);font-size:14px}
.card .value{font-size:28px;font-weight:650;letter-spacing:-.02em;line-height:1.25;font-variant-numeric:tabular-nums}
.card .value small{font-size:17px;font-weight:500;color:var(--muted);letter-spacing:0}
.card .basis{color:var(--muted);font-size:13px;margin-top:4px}
.badge{display:inline-block;border-radius:99px;padding:0 9px;font-size:14px;font-weight:600;vertical-align:3px;
margin-left:8px;letter-spacing:0}
.better{color:var(--good);background:var(--good-bg)}
.worse{color:var(--bad);background:var(--bad-bg)}
.same{color:var(--muted);background:var(--flat-bg)}
.grid{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,480px),1fr));gap:16px;align-items:start}
.grid.small{grid-template-columns:repeat(auto-fill,minmax(min(100%,240px),1fr));margin-top:16px}
.grid.medium{grid-template-columns:repeat(auto-fill,minmax(min(100%,330px),1fr))}
.grid>div{min-width:0;display:grid;gap:16px}
figure{margin:0;padding:14px 14px 10px;min-width:0}
figure svg{display:block;width:100%;max-width:680px;height:auto;max-height:78vh;margin:0 auto}
figcaption{color:var(--muted);font-size:13.5px;line-height:1.45;margin-top:6px}
.scroll{overflow-x:auto;margin:12px 0 6px}
table{border-collapse:collapse;width:100%;font-size:14.5px;font-variant-numeric:tabular-nums}
caption{text-align:left;font-weight:600;padding:12px 16px 4px}
th,td{padding:7px 12px;text-align:right;white-space:nowrap;border-bottom:1px solid var(--grid)}
thead th{color:var(--muted);font-weight:500;font-size:13px}
th:first-child{text-align:left;padding-left:16px}
tbody th{font-weight:500}
tbody tr:last-child>*{border-bottom:0}
td b,th b{color:var(--good);font-weight:700}
.note{color:var(--muted);font-size:13.5px;margin:4px 2px 0;max-width:120ch}
.tiles{display:grid;grid-template-columns:repeat(var(--across,4),1fr);gap:10px}
.tiles .newline{grid-column-start:var(--start,3)}
.tiles div{min-width:0}
.tiles img{display:block;width:100%;height:auto;border-radius:7px;background:var(--flat-bg)}
.tiles p{margin:3px 1px 0;font-size:13px;line-height:1.35;color:var(--muted)}
.tiles p b{color:var(--ink);font-weight:600}
.bars{display:flex;flex-wrap:wrap;gap:6px 26px;margin-top:12px;font-size:13px;color:var(--muted)}
.bars>span{display:inline-flex;align-items:center;gap:8px}
.bar{width:120px;height:9px;border-radius:99px;display:inline-block}
.frame{margin-bottom:16px}
.live,.slider{display:none}.js .live,.js .slider{display:block}.js .static{display:none}
.view3d canvas{display:block;width:100%;height:min(62vh,460px);touch-action:none;cursor:grab;border-radius:8px;
border:1px solid var(--grid)}
.view3d canvas:focus-visible,.stage:focus-within{outline:2px solid var(--accent)}
.choices{display:flex;flex-wrap:wrap;gap:8px;margin:0 0 10px}
button{font:600 14px var(--sans);color:var(--ink);background:var(--flat-bg);border:1px solid var(--grid);
padding:6px 14px;border-radius:99px;cursor:pointer}
button[aria-pressed=true]{background:var(--accent);color:var(--card);border-color:var(--accent)}
.toggles{display:flex;flex-wrap:wrap;gap:4px 18px;margin-top:10px;font-size:14px}
.toggles label{display:inline-flex;align-items:center;gap:7px;min-height:30px;cursor:pointer;overflow-wrap:anywhere}
.toggles i{width:18px;height:4px;border-radius:2px;flex:none}
.hint{color:var(--muted);font-size:13px;margin:4px 0 0}
.slider{max-width:760px;margin:0 auto 16px}
.stage{position:relative;--line:var(--at,50%)}
.stage img{display:block;width:100%;height:auto;border-radius:7px}
.stage .over{position:absolute;inset:0;clip-path:inset(0 calc(100% - var(--line)) 0 0)}
.stage>i{position:absolute;top:0;bottom:0;left:calc(var(--line) - 1.5px);width:3px;background:#fff;
box-shadow:0 0 4px #000a;pointer-events:none}
.stage>i::after{content:"";position:absolute;top:50%;left:50%;width:30px;height:30px;margin:-15px;border-radius:50%;
background:#fff;box-shadow:0 0 5px #0009}
.stage>span{position:absolute;top:8px;left:8px;background:#000a;color:#fff;border-radius:5px;padding:1px 8px;
font-size:13px;pointer-events:none}
.stage>span~span{left:auto;right:8px}
.stage input{position:absolute;inset:0;width:100%;height:100%;margin:0;opacity:0;cursor:ew-resize;touch-action:pan-y}
details{padding:0 16px;margin:12px 0}
summary{cursor:pointer;padding:11px 0;font-weight:600}
pre{font:12.5px/1.5 var(--mono);overflow:auto;max-height:70vh;margin:0 0 14px;white-space:pre}
.facts{display:grid;grid-template-columns:auto 1fr;gap:3px 18px;margin:0 0 14px;font-size:14.5px}
.facts dt{color:var(--muted)}.facts dd{margin:0;overflow-wrap:anywhere}
.files{columns:2 300px;margin:0 0 14px;padding-left:18px;font-size:14px}
a{color:var(--accent)}
.problems{border-left:4px solid var(--bad);background:var(--bad-bg);padding:10px 16px;border-radius:6px;margin-top:20px}
.problems p{margin:2px 0}
footer{color:var(--muted);font-size:13.5px;padding:36px 24px 48px}
@media (max-width:560px){
main,header,footer{padding-left:14px;padding-right:14px}header{padding-top:24px}h1{font-size:26px}
.lead{font-size:17px}figure{padding:10px 8px 8px}th,td{padding:6px 9px}.card .value{font-size:25px}
h2{margin-top:34px}.grid.small{grid-template-columns:1fr 1fr;gap:10px}
.tiles{grid-template-columns:1fr 1fr;gap:8px}.tiles .newline{grid-column-start:auto}}
@media print{
.js .live,.js .slider{display:none}.js .static{display:block}
:root{color-scheme:light;--page:#fff;--card:#fff;--ink:#000;--muted:#444;--grid:#ccc;--good:#0d5c39;--bad:#8a3511;
--good-bg:#fff;--bad-bg:#fff;--flat-bg:#fff}body{font-size:11pt}main,header,footer{max-width:none;padding:0}
figure,.card,.scroll,.frame{break-inside:avoid}h2,h3,.lede{break-after:avoid}
.scroll{overflow:visible}table{font-size:8.5pt}
th,td{padding:3px 5px;white-space:normal}pre{max-height:none;white-space:pre-wrap}
.cards{grid-template-columns:repeat(4,1fr)}
.grid{grid-template-columns:1fr 1fr}.grid.small{grid-template-columns:repeat(4,1fr)}
.grid.medium{grid-template-columns:repeat(3,1fr)}.card .value{font-size:17pt}
figcaption,.note,.card .basis{font-size:8.5pt}
*{-webkit-print-color-adjust:exact;print-color-adjust:exact}}
"""
