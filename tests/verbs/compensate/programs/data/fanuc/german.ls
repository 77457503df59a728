/PROG  GERMAN
/ATTR
OWNER		= MNEDITOR;
COMMENT		= "Grüße";
PROG_SIZE	= 900;
LINE_COUNT	= 8;
PROTECT		= READ_WRITE;
TCD:  STACK_SIZE	= 0,
      PAUSE_REQUEST	= 0;
DEFAULT_GROUP	= 1,*,*,*,*;
CONTROL_CODE	= 00000000 00000000;
/APPL
/MN
   1:  UFRAME_NUM=0 ;
   2:  UTOOL_NUM=1 ;
   3:  !Anstoß prüfen L P[3] ;
   4:J P[1] 100% CNT0 ACC100 ZEIT VOR    .10sek,P-SPS     ;
      1:  TC_ONLINE (ON) ;
      2:  A[23]=(AUS) ;
      3:  !M[14] = (!E[63] AND E[64]) ;
       ------ ;
   5:L P[2] 200mm/sek CNT100 ACC100 WEG VOR  10.0mm,P-SPS     ;
      1:  A[24]=EIN ;
       ------ ;
   6:J P[3] 100% CNT0 ACC100 ZEIT VOR   0.00sek,P-SPS WKZ_Offset ,PR[12] Offset,PR[11]     ;
   7:L P[1] max_Geschw. CNT0 ACC100 ;
   8:L P[2] 20mm/sek CNT0 Interrupt,LABEL[3] ;
  11:L P[4] 100mm/sek CNT0 RTCP    ;
/POS
P[1]{
   GP1:
	UF : 0, UT : 1,		KONFIG : 'N U T, 0, 0, 0',
	X =   928.108  mm,	Y =    88.383  mm,	Z =   316.297  mm,
	W =   156.348 deg,	P =    -1.933 deg,	R =    48.192 deg
};
P[2]{
   GP1:
	UF : 0, UT : 1,		KONFIG : 'N U T, 0, 0, 0',
	X =   910.824  mm,	Y =  -357.569  mm,	Z =   155.835  mm,
	W =  -176.767 deg,	P =   -14.369 deg,	R =    69.018 deg
};
P[3]{
   GP1:
	UF : 0, UT : 1,		KONFIG : 'N U T, 0, 0, 0',
	X =   689.361  mm,	Y =   289.308  mm,	Z =   461.918  mm,
	W =   159.954 deg,	P =   -35.303 deg,	R =   -13.117 deg
};
P[4]{
   GP1:
	UF : 0, UT : 1,		KONFIG : 'N U T, 0, 0, 0',
	RX =   100.000  mm,	RY =   200.000  mm,	RZ =     -.937  mm,
	RW =     5.719 deg,	RP =     1.772 deg,	RR =   175.588 deg
};
/END
