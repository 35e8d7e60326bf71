#include "stages/report/html.h"

#include <fmt/format.h>

#include <cmath>
#include <fstream>
#include <iterator>
#include <set>
#include <stdexcept>

#include "formats/io/error.h"
#include "stages/core/app/report.h"

namespace loom::report {
namespace {

void replace_all(std::string& text, std::string_view from, std::string_view to) {
    for (std::size_t at = 0; (at = text.find(from, at)) != std::string::npos; at += to.size())
        text.replace(at, from.size(), to);
}

}  // namespace

std::string escaped(std::string_view text) {
    std::string out;
    for (char c : text) {
        switch (c) {
            case '&':
                out += "&amp;";
                break;
            case '<':
                out += "&lt;";
                break;
            case '>':
                out += "&gt;";
                break;
            case '"':
                out += "&quot;";
                break;
            case '\'':
                out += "&#39;";
                break;
            default:
                out += c;
        }
    }
    return out;
}

std::string base64(std::span<const std::uint8_t> bytes) {
    static constexpr char digits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    std::string out;
    out.reserve((bytes.size() + 2) / 3 * 4);
    for (std::size_t i = 0; i < bytes.size(); i += 3) {
        const std::size_t n = std::min<std::size_t>(3, bytes.size() - i);
        std::uint32_t bits = 0;
        for (std::size_t k = 0; k < 3; ++k) bits = bits << 8 | (k < n ? bytes[i + k] : 0u);
        for (std::size_t k = 0; k < 4; ++k) out += k <= n ? digits[bits >> (18 - 6 * k) & 63] : '=';
    }
    return out;
}

std::string number(double value) {
    if (std::isnan(value)) return "–";
    if (std::isinf(value)) return value > 0 ? "∞" : "−∞";
    const double size = std::abs(value);
    std::string text;
    if (size == 0 || (size >= 1e-3 && size < 1e5)) {
        const int places = size == 0 ? 0 : std::max(0, 2 - int(std::floor(std::log10(size) + 1e-12)));
        text = fmt::format("{:.{}f}", value, places);
    } else {
        text = fmt::format("{:.2e}", value);
        const std::size_t e = text.find('e');
        const int exponent = std::stoi(text.substr(e + 1));
        text = fmt::format("{}\u202f·\u202f10<sup>{}</sup>", text.substr(0, e), exponent);
    }
    replace_all(text, "-", "−");
    return text;
}

std::string number(double value, double se) {
    if (std::isnan(se) || std::isnan(value)) return number(value);
    // Two digits, in the notation of the value.
    const bool plain = std::abs(value) >= 1e-3 && std::abs(value) < 1e5 && se > 1e-8;
    const std::string error =
        plain ? fmt::format("{:.{}f}", se, std::max(0, 1 - int(std::floor(std::log10(se) + 1e-12)))) : number(se);
    return fmt::format("{}\u202f<small>±\u202f{}</small>", number(value), error);
}

std::string counted(double value) {
    return value == 0 ? "–" : number(value);
}

std::string bytes(double value) {
    return value == 0 ? "–" : escaped(app::bytes_text(std::uint64_t(value)));
}

std::string section(const std::string& id, const std::string& title, const std::string& body) {
    return body.empty() ? "" : fmt::format("<section id=\"{}\">\n<h2>{}</h2>\n{}</section>\n", id, title, body);
}

std::string embedded_json(std::string json) {
    replace_all(json, "<", "\\u003c");
    return json;
}

std::string filled(std::string_view text, const std::map<std::string, std::string>& values) {
    std::string out;
    std::set<std::string> used;
    for (std::size_t at = 0;;) {
        const std::size_t open = text.find("{{", at);
        out += text.substr(at, open - at);
        if (open == std::string_view::npos) break;
        const std::size_t close = text.find("}}", open);
        const std::string name(text.substr(open + 2, close - open - 2));
        const auto value = values.find(name);
        if (value == values.end()) throw std::logic_error("page: nothing is called " + name);
        out += value->second;
        used.insert(name);
        at = close + 2;
    }
    for (const auto& [name, value] : values)
        if (!used.contains(name)) throw std::logic_error("page: has no place for " + name);
    return out;
}

std::string table(const Cells& head, const std::vector<Cells>& rows) {
    std::string out = "<div class=\"scroll\"><table>\n<thead><tr>";
    for (const std::string& cell : head) out += fmt::format("<th scope=\"col\">{}</th>", cell);
    out += "</tr></thead>\n<tbody>\n";
    for (const Cells& row : rows) {
        out += "<tr>";
        for (std::size_t k = 0; k < row.size(); ++k)
            out += k == 0 ? fmt::format("<th scope=\"row\">{}</th>", row[k]) : fmt::format("<td>{}</td>", row[k]);
        out += "</tr>\n";
    }
    return out + "</tbody></table></div>\n";
}

std::string chart_figure(const std::string& file, const std::string& prefix, int number, const std::string& title,
                         const std::string& text) {
    std::ifstream in(file, std::ios::binary);
    if (!in) throw InputError(fmt::format("{}: cannot be read", file));
    const std::string svg{std::istreambuf_iterator<char>(in), {}};
    return fmt::format("<figure class=\"chart\">\n{}\n<figcaption><b>Figure {}. {}.</b> {}</figcaption>\n</figure>\n",
                       inline_svg(svg, prefix, file), number, escaped(title), escaped(text));
}

std::string inline_svg(std::string_view svg, std::string_view prefix, std::string_view file) {
    const std::size_t begin = svg.find("<svg");
    if (begin == std::string_view::npos) throw InputError(fmt::format("{}: is no SVG", file));
    if (svg.find("<script") != std::string_view::npos)
        throw InputError(fmt::format("{}: holds a script; a page must not run what its inputs bring", file));
    std::string out(svg.substr(begin));
    for (const char* mark : {" id=\"", " id='", "href=\"#", "href='#", "url(#"})
        replace_all(out, mark, fmt::format("{}{}-", mark, prefix));
    // Browsers would display it as a tooltip of the whole chart.
    replace_all(out, "<title>Gnuplot</title>\n", "");
    return out;
}

}  // namespace loom::report
