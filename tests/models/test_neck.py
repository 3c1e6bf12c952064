import torch

from models.config import ModelConfig
from models.neck import EncoderLayer, build_neck, sine_encoding


def test_both_necks_give_the_same_channels_at_every_stride() -> None:
    for neck in ("pafpn", "hybrid"):
        for strides in ((8, 16, 32), (16, 32)):
            config = ModelConfig(1, "tiny", neck, strides=strides)
            features = [torch.rand(1, c, 64 // s, 96 // s) for c, s in zip(config.channels, (8, 16, 32), strict=True)]
            out = build_neck(config)(tuple(features))
            assert [x.shape for x in out] == [(1, config.head_channels, 64 // s, 96 // s) for s in strides]


def test_the_sine_encoding_tells_rows_from_columns() -> None:
    code = sine_encoding(3, 4, 16, torch.device("cpu"))
    assert code.shape == (12, 16)
    # Row 1, column 2: the first half speaks of x, the second of y.
    assert torch.allclose(code[6, 0], torch.tensor(2.0).sin())
    assert torch.allclose(code[6, 8], torch.tensor(1.0).sin())


def test_attention_matches_the_textbook_formula() -> None:
    torch.manual_seed(0)
    layer = EncoderLayer(16, heads=2, hidden=8).eval()
    x = torch.randn(1, 16, 2, 3)
    tokens = x.flatten(2).transpose(1, 2)
    qk = layer.query_key(tokens + sine_encoding(2, 3, 16, x.device))
    query, key, value = qk[..., :16], qk[..., 16:], layer.value(tokens)
    heads = []
    for h in (slice(0, 8), slice(8, 16)):
        weight = (query[..., h] @ key[..., h].transpose(1, 2) / 8**0.5).softmax(-1)
        heads.append(weight @ value[..., h])
    mixed = layer.norm1(tokens + layer.out(torch.cat(heads, -1)))
    expected = layer.norm2(mixed + layer.feed(mixed)).transpose(1, 2).reshape(1, 16, 2, 3)
    assert torch.allclose(layer(x), expected, atol=1e-5)
